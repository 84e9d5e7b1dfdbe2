"""A student learns by lidar what an expert does who knows the map."""
