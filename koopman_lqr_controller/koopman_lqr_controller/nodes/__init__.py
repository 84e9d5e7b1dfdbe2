"""The controller node and the scripted driver."""
