"""Schemas of task files, one module a part."""
