"""Drives a robot to goals on a map: value function in the background, look-ahead in the foreground. No ROS."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation.driving.decision import Decision, Goal, NavigatorOptions, NavigatorState, stand
from ctrl_rl_navigation.driving.keep_off import BESIDE, PAUSE, to_leave
from ctrl_rl_navigation.driving.look_ahead import REVERSING, SPEEDS, TURNS_AFTER, LookAhead
from ctrl_rl_navigation.driving.map_keeper import keep_map_value
from ctrl_rl_navigation.driving.obstacle_changes import have_gone, on_the_way
from ctrl_rl_navigation.driving.obstacle_layer import ObstacleLayer
from ctrl_rl_navigation.driving.progress import PATIENCE, Progress
from ctrl_rl_navigation.driving.value_keeper import Change
from ctrl_rl_navigation.people import NOBODY, mover
from ctrl_rl_navigation.robot import DriveLimits
from ctrl_rl_navigation.values.map_solver import longest_time_beside
from ctrl_rl_navigation.values.map_value import MapValue, path_length

Array = NDArray[np.float64]

_LOOK_PERIOD = 1.0
"""Interval between checks of the path [s]."""
_SOLVE_PERIOD = 2.0
"""Minimum interval between solves for one goal [s]."""
_DOUBT = 2.0
"""Time after which an obstacle that closes the last way may have gone [s]: the robot looks again, once."""
_SLACK = 0.1
"""Distance beyond the tolerance at which a blocked robot counts as arrived [m]."""
_NO_PATH: Array = np.empty((0, 2))


class Navigator:
    """Drives one robot to consecutive goals.

    Attributes:
        limits: Size and limits of the robot.
        options: Settings of the navigator.
        path: Positions from the robot to the goal (n, 2) [m].
        layer: Unmapped obstacles; None without a map.
    """

    def __init__(self, limits: DriveLimits, options: NavigatorOptions | None = None) -> None:
        self.limits, self.options = limits, options or NavigatorOptions()
        turns, speeds = (TURNS_AFTER, REVERSING) if limits.width else ((0.0,), SPEEDS)
        timing = self.options.period, self.options.delay, self.options.deceleration
        self._ahead = LookAhead(limits, *timing, turns_after=turns, speeds=speeds)
        self._keeper = keep_map_value(limits, self.options)
        self.path: Array = _NO_PATH
        self.layer: ObstacleLayer | None = None
        self._ended: tuple[NavigatorState, str] | None = None
        self._command = np.zeros(2)
        self._solved_at = self._looked_at = -math.inf
        self._progress, self._ever = Progress(), _NO_PATH
        self._clear: MapValue | None = None
        self._off_until = -math.inf
        self._stuck = self._sees_anew = self._taken = self._holds = self._looks_again = False

    @property
    def goal(self) -> Goal | None:
        """Current or last reached goal; None for none."""
        return self._keeper.goal

    @property
    def value(self) -> MapValue | None:
        """Time to reach the goal; None without a goal."""
        return self._keeper.value

    @property
    def is_asked(self) -> bool:
        """Whether a goal is still without a value."""
        return self._keeper.is_asked

    @property
    def solving(self) -> float:
        """Completed fraction of the running solve; NaN if there is none."""
        return self._keeper.done

    @property
    def solves(self) -> int:
        """Number of value functions solved."""
        return self._keeper.solves

    @property
    def detour(self) -> float:
        """Time that unmapped obstacles have added to the way to the current goal [s]."""
        return self._progress.detour

    @property
    def remaining_distance(self) -> float:
        """Remaining path length since the last check [m]; NaN without a path."""
        return path_length(self.path) if len(self.path) else math.nan

    def set_map(self, map_: OccupancyMap) -> None:
        """Use another map; until the goal is solved on it, the robot continues with the old map."""
        self._keeper.set_map(map_)

    def set_goal(self, goal: Goal) -> None:
        """Drive to another goal; the robot continues to the old goal until the new value is ready."""
        self._keeper.ask(goal)

    def cancel(self) -> bool:
        """Cancel the goal and return whether there was one."""
        had = self._keeper.is_asked or (self.goal is not None and self._ended is None)
        self._keeper.drop()
        self.path = _NO_PATH
        if had:
            self._ended = (NavigatorState.CANCELLED, "the goal was cancelled")
        return had

    def sent(self, command: Array) -> None:
        """Record the command actually sent; acceleration limits apply relative to this command."""
        self._command = np.array(command, np.float64)

    def poll(self, now: float) -> None:
        """Process finished background work at a steady time [s]; `decide` does this too."""
        change = self._keeper.poll(keep_goal=self._ended is None)
        if change is Change.NOTHING:
            return
        self._solved_at, self._looked_at = now, -math.inf
        self._taken = change is Change.TAKEN
        self._progress.solved()
        self._ever = np.unique(np.concatenate((self._ever, self._keeper.known)), axis=0)
        if change is Change.MAP:
            assert self._keeper.solver is not None
            self.layer = ObstacleLayer(self._keeper.solver.map, self._keeper.solver.clearance, self.options.memory)
            self.poll(now)
        elif change is Change.GOAL:
            self._begin(now)
        elif change is Change.REFUSED:
            self._ended, self.path = (NavigatorState.UNREACHABLE, self._keeper.reason), _NO_PATH

    def _begin(self, now: float) -> None:
        """Begin a drive to a goal; what was seen long before may have gone."""
        self._ended, self._ever, self._clear = None, _NO_PATH, self.value
        self._off_until = -math.inf
        self._holds = self._looks_again = False
        self._progress.begin()
        assert self.layer is not None
        self.layer.forget(now, self.options.memory)

    def see(self, now: float, pose: Array, points: Array, empty: Array = _NO_PATH) -> None:
        """Process a scan.

        Args:
            now: Steady time [s].
            pose: Pose of the robot at the scan (3,) [m, m, rad].
            points: Echoes in the robot's frame (n, 2) [m].
            empty: Ends of the beams without an echo in the robot's frame (m, 2) [m].
        """
        if self.layer is not None:
            self.layer.update(now, pose, points, empty, close_to_walls=self._stuck)
            self._sees_anew, self._stuck = self._sees_anew or self._stuck, False

    def decide(self, now: float, pose: Array, points: Array, movers: Array = NOBODY) -> Decision:
        """Return the decision for this period.

        Args:
            now: Steady time [s].
            pose: Pose of the robot in the map frame (3,) [m, m, rad].
            points: Echoes of what stands in the robot's current frame (n, 2) [m].
            movers: Predicted movers in the map frame (m, 12), see `people.movers`.
        """
        self.poll(now)
        if self._keeper.solver is None:
            preparing = "preparing the map" if self._keeper.prepares_map else "waiting for a map"
            return stand(NavigatorState.WAITING, preparing)
        if self._ended is not None:
            return stand(*self._ended)
        goal, value = self.goal, self.value
        if goal is None or value is None:
            if self._keeper.at_work:
                return stand(NavigatorState.SOLVING, f"solving, {100 * self._keeper.done:.0f} % done")
            return stand(NavigatorState.WAITING, "waiting for a goal")
        left = float(value.value(pose[:2]))
        if self._is_there(pose, goal, left):
            return self._arrive(pose, goal)
        self._look(now, pose, value)
        if self._taken:
            return self._keep_off(pose, points, movers, "an unmapped obstacle covers the goal")
        if not math.isfinite(left):
            decision = self._no_way(now, pose)
            if decision.state is NavigatorState.BLOCKED:
                return self._keep_off(pose, points, movers, decision.message)
            return decision
        return self._drive(now, pose, points, left, movers)

    def _drive(self, now: float, pose: Array, points: Array, left: float, movers: Array) -> Decision:
        assert self.value is not None
        progress = self._progress
        if progress.note(now, pose[:2], left):
            self._stuck = True
            if math.dist(pose[:2], self.value.goal) < BESIDE:
                self._off_until = now + PAUSE
        if progress.passes > 2:
            message = f"the same way was driven {progress.passes} times without getting nearer to the goal"
            self._ended = (NavigatorState.BLOCKED, message)
            return stand(*self._ended)
        if progress.detour > self.options.max_detour:
            return stand(NavigatorState.BLOCKED, f"{progress.words} is more than `max_detour`")
        if now < self._off_until:
            return self._keep_off(pose, points, movers, "something beside the goal is in the way")
        if progress.passes == 2:
            self._insist(now)
        choice = self._ahead.choose(self.value, pose, self._command, points, movers=movers)
        if progress.tries > 1:
            message = f"no progress for {progress.tries * PATIENCE:.0f} s: something is in the way"
            return Decision(choice.command, NavigatorState.BLOCKED, message, left)
        return Decision(choice.command, NavigatorState.DRIVING, self._doing(), choice.cost)

    def _doing(self) -> str:
        """Return in words what a driving robot does."""
        if self._looks_again:
            return "driving to look again at obstacles seen before: they close every way"
        return f"driving {self._progress.words}".rstrip()

    def _insist(self, now: float) -> None:
        """Believe in every obstacle of this drive, since the robot repeats itself: some seem to come and go."""
        if self.layer is not None and not (self._holds or self._looks_again or self._keeper.at_work):
            self._holds = True
            self.layer.hold(self._ever)
            self._renew(now)

    def _renew(self, now: float) -> None:
        """Start solving the value again with the present obstacles."""
        assert self.layer is not None
        self._solved_at, self._sees_anew = now, False
        self._keeper.renew(self.layer.points())

    def _is_there(self, pose: Array, goal: Goal, left: float) -> bool:
        """Return whether the goal position is reached, ignoring the heading.

        A blocked robot that could not get closer counts as arrived slightly farther away.
        """
        near = self.options.tolerance + (_SLACK if self._progress.tries else 0.0)
        return math.dist(pose[:2], goal.position) <= near and left <= longest_time_beside(near, self.limits)

    def _blocked(self, now: float) -> Decision:
        """Stand before obstacles that close every way; first look again, once, at those that may have gone."""
        assert self.layer is not None
        if not self._looks_again and self.layer.forget(now, _DOUBT):
            self._looks_again = True
            self._renew(now)
        if self._keeper.at_work:
            return stand(NavigatorState.SOLVING, "obstacles close the way: solving another one")
        return stand(NavigatorState.BLOCKED, "an unmapped obstacle blocks every path to the goal")

    def _keep_off(self, pose: Array, points: Array, movers: Array, message: str) -> Decision:
        """Wait at some distance from what covers the goal."""
        assert self.goal is not None
        assert self._clear is not None
        assert self.layer is not None
        stays = to_leave(self.goal.position, self.layer.points(), pose[:2], self.limits.room)
        if not len(stays):
            return stand(NavigatorState.BLOCKED, message)
        choice = self._ahead.choose(self._clear, pose, self._command, points, movers=np.vstack((movers, stays)))
        return Decision(choice.command, NavigatorState.BLOCKED, message)

    def _no_way(self, now: float, pose: Array) -> Decision:
        """Return the decision if the value at the robot is infinite."""
        if len(self._keeper.known):
            return self._blocked(now)
        assert self._keeper.solver is not None
        where = f"({pose[0]:.2f}, {pose[1]:.2f})"
        wrong = self._keeper.solver.no_place(pose[:2])
        if wrong:
            return stand(NavigatorState.WAITING, f"the robot is at {where}, {wrong}: is the pose right?")
        self._ended = (NavigatorState.UNREACHABLE, f"no way leads from {where} to the goal")
        return stand(*self._ended)

    def _arrive(self, pose: Array, goal: Goal) -> Decision:
        """Turn to the goal's heading, or report arrival."""
        if goal.heading is not None:
            error = math.remainder(goal.heading - float(pose[2]), 2.0 * math.pi)
            if abs(error) > self.options.heading_tolerance:
                # A rate from which the robot can stop at the heading with half of its acceleration.
                rate = min(self.limits.turn_rate, math.sqrt(self.limits.turn_acceleration * abs(error)))
                most = self.limits.turn_acceleration * self.options.period
                turn = math.copysign(min(rate, 2.0 * abs(error)), error)
                command = np.array((0.0, np.clip(turn, self._command[1] - most, self._command[1] + most)))
                left = abs(error) / self.limits.turn_rate
                return Decision(command, NavigatorState.DRIVING, "turning into the heading of the goal", left)
        message, away = "the goal is reached", math.dist(pose[:2], goal.position)
        if away > self.options.tolerance:
            message = f"reached to {away:.2f} m: obstacles let the robot come no nearer"
        elif self._progress.words:
            message += f", after {self._progress.words}"
        self._ended = (NavigatorState.REACHED, message)
        self.path = _NO_PATH
        return stand(*self._ended)

    def _look(self, now: float, pose: Array, value: MapValue) -> None:
        """Check the path, and request a new value if obstacles lie on it or have disappeared."""
        if now - self._looked_at < _LOOK_PERIOD:
            return
        self._looked_at = now
        assert self.layer is not None
        self.path = value.path(pose[:2])
        if self._keeper.at_work or now - self._solved_at < _SOLVE_PERIOD:
            return
        points, cell = self.layer.points(), value.map.resolution
        closed = on_the_way(points, self.path, self.limits.room, cell)
        if self._sees_anew or closed or have_gone(self._keeper.known, points, cell):
            self._renew(now)


def warm_up(limits: DriveLimits) -> None:
    """Compile the driving functions, or load them from disk, before timing matters."""
    navigator = Navigator(limits, NavigatorOptions(inline=True))
    navigator.set_map(OccupancyMap(np.zeros((30, 60), np.int8), limits.room))
    navigator.set_goal(Goal((45.0 * limits.room, 15.0 * limits.room)))
    someone = mover(np.array((12.0, 15.0)) * limits.room, np.zeros(2), 0.2, (0.1, 0.0, 0.1))[None]
    pose, echoes = np.array((10.0 * limits.room, 15.0 * limits.room, 0.0)), np.ones((30, 2))
    for now in (0.0, 1.5):
        navigator.see(now, pose, echoes)
        navigator.decide(now, pose, echoes, someone)
