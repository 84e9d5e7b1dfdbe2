"""A policy on a robot that it was not learnt on."""
