from .clocks import warn as warn
