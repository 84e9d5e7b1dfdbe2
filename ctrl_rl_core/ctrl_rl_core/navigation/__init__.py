"""Maps, transforms and poses for robots that drive to a goal on a map."""
