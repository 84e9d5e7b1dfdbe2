"""Guards that compare a robot with what training saw."""
