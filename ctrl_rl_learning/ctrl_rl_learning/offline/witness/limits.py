"""Recorded states, speeds and commands that a task's robot could not have had by its file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, World
from ctrl_rl_learning.offline.witness.record import DriveRecord, Sightings

Array = NDArray[np.float64]
_DEEP = 0.10
"""Depth in a wall of the file that an error of the pose explains [m]."""
_FEW_INSIDE = 0.005
"""Share of the states that may lie deeper."""
_MORE, _SMALL = 1.1, np.array((0.05, 0.1))
"""Share and amounts by which speeds [m/s] and turn rates [rad/s] may exceed their limits: odometry is noisy."""
_FEW_FASTER = 0.02
_NAMES = (("speed", "m/s"), ("turn rate", "rad/s"))


def states_inside(sightings: Sequence[Sightings], task: NavigationTask, worlds: Mapping[int, World]) -> tuple[int, int]:
    """Return how many recorded states lie inside what the file calls a collision, and the number of all.

    The last state of an episode does not count: a simulated body that has collided may be in a wall by then.

    Args:
        sightings: Scans with their poses.
        task: Their task.
        worlds: Walls of episodes that have others than the file, by their number.
    """
    inner = inner_radius(task)
    kept = [(seen.poses[:-1, :2], seen.episodes[:-1], np.diff(seen.episodes) == 0) for seen in sightings]
    places = np.concatenate([poses[same] for poses, _, same in kept])
    episodes = np.concatenate([numbers[same] for _, numbers, same in kept])
    distances, usual = np.empty(len(places)), task.build_world()
    for number in np.unique(episodes).tolist():
        distances[episodes == number] = worlds.get(number, usual).signed_distance(places[episodes == number])
    return int((distances < inner - _DEEP).sum()), len(places)


def inner_radius(task: NavigationTask) -> float:
    """Return the radius of a disc that the body of a task's robot holds [m]."""
    robot = task.robot.robot
    if robot is None:
        return task.robot.radius
    return 0.5 * min(robot.width, robot.length) if robot.width else robot.through_gaps


def many_inside(inside: int, count: int) -> bool:
    """Return whether more states lie inside than errors of poses explain."""
    return inside > max(2, _FEW_INSIDE * count)


def faster_than_robot(record: DriveRecord, task: NavigationTask) -> Iterator[str]:
    """Yield a line for each of speed and turn rate that the task's robot could not drive."""
    low, high = _limits(task)
    for name, share, most, limit, unit in _beyond(record.speeds, low, high):
        if share > _FEW_FASTER:
            yield (
                f"{share:.0%} of the recorded {name}s exceed what the task's robot can do: up to {most:.2f} {unit}, "
                f"its limit is {limit:.2f}"
            )


def commands_beyond(record: DriveRecord, task: NavigationTask) -> Iterator[str]:
    """Yield a line for each of speed and turn rate that was commanded beyond the task's commands."""
    low, high = np.array(list(task.robot.commands.values())).T
    for name, share, most, limit, unit in _beyond(record.commands, low, high):
        if share > _FEW_FASTER:
            yield (
                f"{share:.0%} of the commands ask for a {name} beyond the task's: up to {most:.2f} {unit}, its limit "
                f"is {limit:.2f}; they count as that limit"
            )


def _limits(task: NavigationTask) -> tuple[Array, Array]:
    """Return least and largest speed and turn rate (2,), (2,): the robot's, or the task's commands where larger."""
    low, high = np.array(list(task.robot.commands.values())).T
    robot = task.robot.robot
    if robot is None:
        return low, high
    least, most = (np.array(limit) for limit in robot.limits)
    return np.minimum(low, least), np.maximum(high, most)


def _beyond(numbers: Array, low: Array, high: Array) -> Iterator[tuple[str, float, float, float, str]]:
    """Yield name, share of the numbers (n, 2) beyond their limits, the largest of them, the limit, and the unit."""
    for column, (name, unit) in enumerate(_NAMES):
        given, slack = numbers[:, column], _SMALL[column]
        beyond = (given > _MORE * high[column] + slack) | (given < _MORE * low[column] - slack)
        if beyond.any():
            most = float(given[np.argmax(np.abs(given))])
            yield name, float(beyond.mean()), most, float(high[column] if most > 0.0 else low[column]), unit
