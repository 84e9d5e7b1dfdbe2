from .training import StateReward as StateReward
