from .environment.rewards import StepReward as StepReward
from .environment.robot_env import RobotEnv as RobotEnv
from .learning.fine_tuner import FineTuner as FineTuner
from .learning.fine_tuner import TuneSettings as TuneSettings
from .learning.policy import read_policy as read_policy
from .learning.session import EpisodeLog as EpisodeLog
from .learning.session import Session as Session
