"""Environments and benchmark tasks."""
