"""The physics engines behind the simulation, and the seam that they share."""
