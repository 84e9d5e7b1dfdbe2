from .warming import warm_up as warm_up
