"""Schemas of task files, one module per part."""
