from .barn.dynamic_window import DynamicWindow as DynamicWindow
from .barn.dynamic_window import DynamicWindowOptions as DynamicWindowOptions
from .errors import TrialError as TrialError
from .ladder import LADDER as LADDER
from .ladder import load_ladder_task as load_ladder_task
