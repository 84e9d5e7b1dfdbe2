from .progress import PAYS as PAYS
from .progress import PER_SECOND as PER_SECOND
from .progress import BestProgress as BestProgress
from .progress import Potential as Potential
from .progress import PotentialReward as PotentialReward
from .progress import Progress as Progress
from .progress import Shaping as Shaping
from .rewards import longest_time as longest_time
