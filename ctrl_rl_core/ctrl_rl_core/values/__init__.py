"""Value functions on regular grids: interpolation, files, and the protocol of their users."""
