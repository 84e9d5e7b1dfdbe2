from .clocks import Tell as Tell
from .clocks import warn as warn
