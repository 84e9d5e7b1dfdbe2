"""Commands of this package, which need the simulator."""
