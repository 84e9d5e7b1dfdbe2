"""Runs episodes with one robot, one driver and one filter.

    episodes = drive(robot, driver, filter, seeds=range(100))
    episodes.success, episodes.outcomes, episodes.seconds

A robot has Gymnasium's interface, so any environment can serve as one. The driver receives `Sensors`, or the
environment's own observation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.tasks.outcome import Outcome

Array = NDArray[np.float64]
Command = NDArray[np.float64]
"""Speed [m/s] and turn rate [rad/s], thrusts T_1 and T_2 [N], or an environment's action (2,)."""

Seen = TypeVar("Seen")
SeenOut = TypeVar("SeenOut", covariant=True)
SeenIn = TypeVar("SeenIn", contravariant=True)


class Driver(Protocol[SeenIn]):
    """Chooses commands: a policy, a controller, a navigator or an adversary."""

    def command(self, sensors: SeenIn, /) -> Command:
        """Return the command (2,) for the current sensor readings.

        Raises:
            CtrlRlError: No command is available, so the robot must stop; the message gives the reason.
        """


class FunctionDriver(Generic[Seen]):
    """Wraps a function from sensor readings to commands as a driver."""

    def __init__(self, decide: Callable[[Seen], Any]) -> None:
        self._decide = decide

    def command(self, sensors: Seen, /) -> Command:
        """Return the command (2,)."""
        command: Command = self._decide(sensors)
        return command


class Filter(Protocol[SeenIn]):
    """Modifies commands between driver and robot."""

    def __call__(self, sensors: SeenIn, command: Command, /) -> Command:
        """Return the command (2,) to send instead of the driver's."""


class DrivenRobot(Protocol[SeenOut]):
    """A robot with Gymnasium's interface; one step holds a command for one period."""

    def reset(self, *, seed: int) -> tuple[SeenOut, dict[str, Any]]:
        """Start an episode with a seed."""

    def step(self, command: Any, /) -> tuple[SeenOut, Any, bool, bool, dict[str, Any]]:
        """Hold a command for one period; return sensors, reward, terminated, truncated and info, as in Gymnasium."""


class Step(NamedTuple, Generic[Seen]):
    """One state of an episode, and the command that led to it.

    Attributes:
        sensors: Sensor readings in that state, or the environment's observation.
        command: Command held before that state (2,); None at the start.
        reward: Reward of that command.
        info: Further data on the state, as Gymnasium's `info`.
        terminated: Whether the episode ended there, other than by truncation.
    """

    sensors: Seen
    command: Command | None
    reward: float
    info: Mapping[str, Any]
    terminated: bool = False


@dataclass(frozen=True)
class Episode(Generic[Seen]):
    """Result of one episode.

    Attributes:
        seed: Seed of the start and of all noise.
        steps: Number of commands.
        total: Undiscounted return.
        changed: Fraction of the commands that the filter changed.
        info: `info` of the last step, with `outcome` if the robot reports one.
        trace: All states including the start; empty unless they were kept.
    """

    seed: int
    steps: int
    total: float
    changed: float
    info: Mapping[str, Any]
    trace: Sequence[Step[Seen]] = ()

    @property
    def outcome(self) -> str:
        """Name of the outcome; empty if the robot reports none."""
        return str(self.info.get("outcome", ""))

    @property
    def states(self) -> Array:
        """True states (steps + 1, n), if they were kept."""
        return np.array([step.info["state"] for step in self.trace])


class Episodes(tuple[Episode[Seen], ...]):
    """Episodes in seed order; each property is an array with one element per episode."""

    __slots__ = ()

    def __repr__(self) -> str:
        counted = {name: self.outcomes.count(name) for name in sorted(set(self.outcomes))}
        return f"{len(self)} episodes: {', '.join(f'{count} {name}' for name, count in counted.items())}"

    @property
    def seeds(self) -> NDArray[np.int64]:
        """Seeds (N,)."""
        return np.array([each.seed for each in self], dtype=np.int64)

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Names of the outcomes: GOAL, COLLISION, TRAP or TIMEOUT (N,)."""
        return tuple(each.outcome for each in self)

    @property
    def steps(self) -> NDArray[np.int64]:
        """Numbers of commands (N,)."""
        return np.array([each.steps for each in self], dtype=np.int64)

    @property
    def returns(self) -> Array:
        """Undiscounted returns (N,)."""
        return np.array([each.total for each in self], dtype=np.float64)

    @property
    def changed(self) -> Array:
        """Fractions of the commands that the filter changed (N,)."""
        return np.array([each.changed for each in self], dtype=np.float64)

    @property
    def seconds(self) -> Array:
        """Simulated durations (N,) [s]."""
        return self._told("seconds", np.float64)

    @property
    def distances(self) -> Array:
        """Distances driven (N,) [m]."""
        return self._told("distance", np.float64)

    @property
    def avoidable(self) -> NDArray[np.bool_]:
        """Whether each episode ended in a contact that the robot could have avoided (N,)."""
        return self._told("avoidable", np.bool_)

    @property
    def success(self) -> float:
        """Fraction of the episodes that reached the goal."""
        return self.rate(Outcome.GOAL)

    @property
    def collisions(self) -> float:
        """Fraction of the episodes that ended in a contact."""
        return self.rate(Outcome.COLLISION)

    def rate(self, outcome: Outcome) -> float:
        """Return the fraction of episodes with this outcome."""
        return self.outcomes.count(outcome.name) / max(len(self), 1)

    def _told(self, name: str, kind: Any) -> NDArray[Any]:
        return np.array([each.info[name] for each in self], dtype=kind)


def drive(
    robot: DrivenRobot[Seen],
    driver: Driver[Seen],
    filter: Filter[Seen] | None = None,  # noqa: A002 - the word of the field
    seeds: Iterable[int] = range(100),
    *,
    keep: bool = False,
    watch: Callable[[Step[Seen]], object] = lambda _: None,
) -> Episodes[Seen]:
    """Drive one episode per seed.

    Args:
        robot: Robot to drive, or any environment.
        driver: Driver; its state carries over between episodes.
        filter: Filter for the driver's commands, or None. A robot may have a filter of its own that runs at a higher
            rate than the driver.
        seeds: Seeds of the episodes.
        keep: Whether each episode keeps its states.
        watch: Called in each state, including the first and the last.
    """
    return Episodes(_play(robot, driver, filter, seed, keep, watch) for seed in seeds)


class Fleet(Protocol[SeenOut]):
    """Robots that are driven in parallel."""

    def begin(self, seeds: Sequence[int], /) -> tuple[SeenOut, Array]:
        """Start one episode per seed; return all sensor readings and the states (N, n)."""

    def step(self, commands: Any, /) -> tuple[SeenOut, Array, Array, NDArray[np.intp]]:
        """Hold one command per robot; return sensor readings, states (N, n), rewards (N,) and outcomes (N,)."""


def drive_fleet(
    fleet: Fleet[Seen], decide: Callable[[Seen], Any], seeds: Iterable[int], longest: int | None = None
) -> Episodes[None]:
    """Drive one episode per seed in parallel until the last one ends; all states are kept.

    Args:
        fleet: Robots to drive.
        decide: Returns the commands of all robots for their sensor readings.
        seeds: Seeds of the episodes, one per robot.
        longest: Maximum number of steps, after which running episodes are abandoned; None for no limit.
    """
    chosen = list(seeds)
    if not chosen:
        return Episodes(())
    sensed, states = fleet.begin(chosen)
    traces = [[Step[None](None, None, 0.0, {"state": state})] for state in states]
    outcomes = np.full(len(chosen), int(Outcome.RUNNING))
    while (running := np.flatnonzero(outcomes == Outcome.RUNNING)).size and len(traces[running[0]]) - 1 != longest:
        sensed, states, rewards, told = fleet.step(decide(sensed))
        outcomes[running] = told[running]
        for robot in running.tolist():
            info = {"state": states[robot], "outcome": Outcome(outcomes[robot]).name}
            traces[robot].append(Step(None, None, float(rewards[robot]), info))
    return Episodes(
        Episode(seed, len(trace) - 1, sum(step.reward for step in trace), 0.0, trace[-1].info, tuple(trace))
        for seed, trace in zip(chosen, traces, strict=True)
    )


def _play(
    robot: DrivenRobot[Seen],
    driver: Driver[Seen],
    filter_: Filter[Seen] | None,
    seed: int,
    keep: bool,
    watch: Callable[[Step[Seen]], object],
) -> Episode[Seen]:
    trace: list[Step[Seen]] = []

    def note(step: Step[Seen]) -> None:
        watch(step)
        if keep:
            trace.append(step)

    sensors, info = robot.reset(seed=seed)
    note(Step(sensors, None, 0.0, info))
    steps, changed, total, over = 0, 0, 0.0, False
    while not over:
        command = driver.command(sensors)
        if filter_ is not None:
            wanted, command = command, filter_(sensors, command)
            changed += not np.array_equal(wanted, command)
        sensors, reward, terminated, truncated, info = robot.step(command)
        note(Step(sensors, command, float(reward), info, bool(terminated)))
        total += float(reward)
        steps += 1
        over = terminated or truncated
    return Episode(seed, steps, total, float(info.get("changed", changed / max(steps, 1))), info, tuple(trace))
