from .experiments.runs import OptionRun as OptionRun
from .experiments.runs import option_runs as option_runs
from .heads.heads import as_numpy as as_numpy
from .heads.heads import make_head as make_head
