from .check import random_starts as random_starts
from .convergence import measure_errors as measure_errors
from .cost import exponent as exponent
from .cost import measure_cost as measure_cost
from .exact_times import Reference as Reference
from .exact_times import reference as reference
