from .models import Dynamics as Dynamics
from .models import Parameter as Parameter
