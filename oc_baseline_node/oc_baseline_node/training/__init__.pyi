from .baselines.policy_gradient import BaselinePolicy as BaselinePolicy
from .baselines.policy_gradient import CorrectedPolicy as CorrectedPolicy
