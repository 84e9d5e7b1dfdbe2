"""Drives of robots that are worse than their models, or whose lidars are turned."""
