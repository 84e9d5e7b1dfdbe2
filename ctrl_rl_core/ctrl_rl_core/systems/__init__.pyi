from .models import Dynamics as Dynamics
