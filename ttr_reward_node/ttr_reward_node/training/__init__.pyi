from .learn import train as train
from .training import StateReward as StateReward
