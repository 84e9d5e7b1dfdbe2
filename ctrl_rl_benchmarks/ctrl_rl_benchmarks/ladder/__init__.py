"""The ladder of tasks: its files, how hard each is, and a page with all of them."""
