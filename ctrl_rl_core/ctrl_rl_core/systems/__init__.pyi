from .models import Dynamics as Dynamics
from .models import Equations as Equations
from .models import Parameter as Parameter
from .number_reader import NumberReader as NumberReader
from .number_reader import Source as Source
from .number_reader import reader_of as reader_of
from .registry import find_model as find_model
