"""One robot's work in a delivery team: its options, their rewards, and what must outlive its process."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from option_coordinator.errors import OptionError
from option_coordinator.protocol.option_executor import AgentObservation, OptionResult
from option_coordinator.teams.team_file import TeamFile, Work

_WORK = re.compile(r"carries=([01]) delivered=(\d{1,6})")


class Delivery:
    """One robot's work; all times are from the same clock [s].

    Args:
        team: Team file of the robot's team.
        name: Name of the robot in the team.

    Attributes:
        carries: Whether the robot carries a parcel.
        delivered: Number of parcels delivered.
        option: Index of the running option; None for none.
    """

    def __init__(self, team: TeamFile, name: str) -> None:
        self._team, self._home = team, team.robots[name].home
        self._endless = team.deliveries == 0
        self._options = tuple(team.options.values())
        self.carries, self.delivered = False, 0
        self.option: int | None = None
        self._began = 0.0
        self._arrived: float | None = None

    def see(self, pose: NDArray[np.float64]) -> AgentObservation:
        """Return the observation at a pose x, y, theta (3,), see `OBSERVED`, and the sensible options."""
        wanted = {Work.WAIT, Work.DELIVER} if self.carries else {Work.WAIT}
        if not self.carries and (self._endless or self.delivered == self._team.deliveries):
            wanted.add(Work.REST)
        if not self.carries and (self._endless or self.delivered < self._team.deliveries):
            wanted.add(Work.FETCH)
        observation = np.array((pose[0], pose[1], self.carries, self.delivered), np.float32)
        legal = np.array([option.work in wanted for option in self._options])
        return AgentObservation(observation, legal, f"carries={int(self.carries)} delivered={self.delivered}")

    def resume(self, work: str) -> None:
        """Take over the work of an earlier process, as observed by `see`.

        Raises:
            OptionError: The text is not the work of a delivery robot.
        """
        found = _WORK.fullmatch(work)
        if found is None:
            raise OptionError(f"{work!r} is not the work of a robot of a delivery team")
        self.carries, self.delivered = found[1] == "1", int(found[2])
        if not self._endless:
            self.delivered = min(self.delivered, self._team.deliveries)

    def begin(self, option: int, now: float) -> None:
        """Start an option."""
        self.option, self._began, self._arrived = option, now, None

    @property
    def place(self) -> tuple[float, float] | None:
        """Goal position of the option [m], or None."""
        if self.option is None:
            return None
        option = self._options[self.option]
        return self._home if option.work is Work.REST else option.station

    def at_place(self, now: float) -> OptionResult | None:
        """Record that the robot has reached the option's position; return the result once the option is done."""
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
        """End the option and return its result; the reward belongs to the last step."""
        steps = max(1, round((now - self._began) / self._team.time_step))
        gamma = self._team.discount
        on_the_way = self._team.rewards.step * float(np.sum(gamma ** np.arange(steps)))
        self.option = None
        return OptionResult(on_the_way + gamma ** (steps - 1) * reward, steps)

    def over(self, option: int) -> bool:
        """Return whether the work is finished after an option."""
        return self._options[option].work is Work.REST and not self._endless
