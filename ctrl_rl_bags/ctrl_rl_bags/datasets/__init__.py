"""Datasets of other libraries from bags, and bags from datasets."""
