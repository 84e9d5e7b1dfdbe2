"""Value functions on regular grids: interpolation, files, and what users of a value may ask."""
