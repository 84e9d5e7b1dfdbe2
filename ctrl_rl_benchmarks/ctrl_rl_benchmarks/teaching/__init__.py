"""Policies that are taught where to drive by the time to reach on a map that they do not see."""
