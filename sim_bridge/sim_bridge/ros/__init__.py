"""The bridge node: a simulated world on the topics of a robot."""
