"""Learning in one house: what every method that trains policies shares."""
