from .option_env import Span as Span
