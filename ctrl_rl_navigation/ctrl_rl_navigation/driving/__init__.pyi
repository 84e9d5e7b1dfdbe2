from .navigator import warm_up as warm_up
from .roll_out import choose as choose
