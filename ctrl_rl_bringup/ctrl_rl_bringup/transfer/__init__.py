"""Shipped policies in both physics engines, under nominal and shifted conditions."""
