from .option_env import Span as Span
from .tasks.team_ways import check_ways as check_ways
