"""The physics engine behind the simulation."""
