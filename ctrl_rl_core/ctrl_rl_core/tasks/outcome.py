"""Outcomes of an episode."""

from enum import IntEnum


class Outcome(IntEnum):
    """Values as in ctrl_rl_msgs/TaskOutcome: intermediate I, goal G, collision C, trap Tr (thesis Eq. 3.9, 3.17)."""

    RUNNING = 0
    GOAL = 1
    COLLISION = 2
    TRAP = 3
    TIMEOUT = 4

    @property
    def words(self) -> str:
        """Description of the outcome."""
        return {"GOAL": "goal reached", "TRAP": "trapped", "TIMEOUT": "time-out"}.get(self.name, self.name.lower())
