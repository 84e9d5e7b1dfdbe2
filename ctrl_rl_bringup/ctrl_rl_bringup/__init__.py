"""Launch files, parameter files and the demo that starts everything."""
