from .evaluate import EvaluateOptions as EvaluateOptions
from .evaluate import report as report
