"""Episodes in the simulator with and without the filter: adversaries, and the policies that ship."""
