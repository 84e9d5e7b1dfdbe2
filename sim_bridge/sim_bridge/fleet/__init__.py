"""Many robots of one task, each in a world of its own, advanced together: as fast as learning wants them."""
