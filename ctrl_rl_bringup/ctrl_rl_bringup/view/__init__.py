"""The page: a robot, its map, its scan, its value and its filter in a browser, live or from a bag."""
