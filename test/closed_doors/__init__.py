"""Drives on floors where doors are closed that are open on the map."""
