"""Drives on floors with doors that are open on the map but closed in the world."""
