"""The guard of a planar quadrotor among shapes that are known: escapes rolled out with all six states."""
