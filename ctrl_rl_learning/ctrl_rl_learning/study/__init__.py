"""Runs that resume, many at a time, their results, and the options of the commands that start them."""
