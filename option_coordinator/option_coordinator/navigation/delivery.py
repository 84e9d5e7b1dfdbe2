"""The work of one robot of a delivery team: options apart from driving, and their rewards."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from option_coordinator.protocol.option_client import AgentObservation, OptionResult
from option_coordinator.teams.team_file import TeamFile, Work


class Delivery:
    """One robot's work. Times are seconds of any one clock.

    Args:
        team: Team file of the robot's team.
        name: Name of the robot in the team.

    Attributes:
        carries: Whether the robot carries a parcel.
        delivered: Number of parcels that it has delivered.
        option: Index of the option that runs, None for none.
    """

    def __init__(self, team: TeamFile, name: str) -> None:
        self._team, self._home = team, team.robots[name].home
        self._options = tuple(team.options.values())
        self.carries, self.delivered = False, 0
        self.option: int | None = None
        self._began = 0.0
        self._arrived: float | None = None

    def see(self, pose: NDArray[np.float64]) -> AgentObservation:
        """Return what a policy is told at a pose x, y, theta (3,), see `OBSERVED`, and which options make sense."""
        wanted = {Work.WAIT}
        if self.delivered == self._team.deliveries:
            wanted.add(Work.REST)
        else:
            wanted.add(Work.DELIVER if self.carries else Work.FETCH)
        observation = np.array((pose[0], pose[1], self.carries, self.delivered), np.float32)
        return AgentObservation(observation, np.array([option.work in wanted for option in self._options]))

    def begin(self, option: int, now: float) -> None:
        """Begin an option."""
        self.option, self._began, self._arrived = option, now, None

    @property
    def place(self) -> tuple[float, float] | None:
        """Position that the option leads to [m], None for none."""
        if self.option is None:
            return None
        option = self._options[self.option]
        return self._home if option.work is Work.REST else option.station

    def at_place(self, now: float) -> OptionResult | None:
        """Note that the robot is where its option leads; return what the option brought once it is done."""
        if self.option is None:
            return None
        self._arrived = now if self._arrived is None else self._arrived
        option = self._options[self.option]
        if now - self._arrived < option.lasts:
            return None
        reward = 0.0
        if option.work is Work.DELIVER and self.carries:
            self.carries, reward = False, self._team.rewards.delivery
            self.delivered += 1
        elif option.work is Work.FETCH:
            self.carries = True
        return self.leave(now, reward)

    def leave(self, now: float, reward: float = 0.0) -> OptionResult:
        """End the option as it stands, and return what it brought, with a reward at its last step."""
        steps = max(1, round((now - self._began) / self._team.time_step))
        gamma = self._team.discount
        on_the_way = self._team.rewards.step * float(np.sum(gamma ** np.arange(steps)))
        self.option = None
        return OptionResult(on_the_way + gamma ** (steps - 1) * reward, steps)

    def over(self, option: int) -> bool:
        """Return whether the work is over with the end of an option."""
        return self._options[option].work is Work.REST
