"""Episodes of a planar quadrotor, driven by an adversary or a policy, with and without its guard."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import (
    Driver,
    NavigationTask,
    OdometryReader,
    Policy,
    PolicyDriver,
    Sensors,
    drive,
    find_policy,
    load_policy,
    task_digest,
)
from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.flight.flight_guard import FlightGuard, FlightOptions
from ctrl_rl_safety.models.quadrotor_model import quadrotor_of
from ctrl_rl_safety.trials.episodes import Cell, TrialOutcome, goal_for, period_of, trial_outcome
from ctrl_rl_safety.trials.robot import TrialRobot
from ctrl_rl_safety.trials.sources import Constant, RandomThrusts
from sim_bridge import SimulatedWorld, SimulationOptions

Array = NDArray[np.float64]

ADVERSARIES = ("full_speed", "random")
GUARDS = ("none", "filter", "mismatch")
"""Guards of flights. With `mismatch`, the guard assumes a 3 % lighter quadrotor, and the resulting error bound."""
_LIGHTER = 0.97
_RATE = 240


class GuardFilter:
    """The guard of planar quadrotors as a robot's filter."""

    looks = False

    def __init__(self, guard: FlightGuard) -> None:
        self._guard, self._read = guard, OdometryReader(("x", "v_x", "z", "v_z", "psi", "omega"))
        self.changed = False

    def __call__(self, sensors: Sensors, command: Array) -> Array:  # noqa: D102 - see Filter
        verdict = self._guard.decide(self._read(sensors.odometry), command)
        self.changed = verdict.changed
        return verdict.thrusts


class FlightPlayer:
    """Runs the episodes of a condition with a flight task.

    A policy flies to a goal at which the episode ends; the guard knows the goal, and does not limit the speed of
    arrival. With an adversary, the guard keeps the quadrotor safe indefinitely.
    """

    def __init__(self, cell: Cell, engine: str, task: NavigationTask) -> None:
        """Load the data shared by all episodes.

        Args:
            cell: Trial condition.
            engine: Physics engine, one of `sim_bridge.ENGINES`.
            task: Task of the condition.

        Raises:
            CtrlRlError: The policy does not exist or is for another kind of robot, or the guard does not exist for
                flights.
        """
        if cell.guard not in GUARDS:
            raise SafetyError(f"guard '{cell.guard}' is for robots on wheels: flights have {', '.join(GUARDS)}")
        self._cell, self._task, self._model = cell, task, quadrotor_of(task)
        self._options = SimulationOptions(engine=engine, rate=_RATE)
        self._policy: Policy | None = None
        if cell.source not in ADVERSARIES:
            self._policy = load_policy(find_policy(cell.source))
            if self._policy.robot != "planar_quadrotor":
                raise SafetyError(f"policy '{cell.source}' is for a {self._policy.robot}: '{cell.place}' flies")

    @property
    def terms(self) -> list[str]:
        """Text that identifies everything the episodes depend on."""
        return [repr(self._model), repr(FlightOptions()), task_digest(self._task)]

    def play(self, seed: int) -> TrialOutcome:
        """Run the episode of a seed and return its outcome."""
        world = SimulatedWorld(self._task, seed, options=self._options)
        tick, policy, task = FlightOptions().tick, self._policy, self._task
        try:
            make_filter = None if self._cell.guard == "none" else lambda: self._guard(world)
            if policy is None:
                robot, driver = TrialRobot(world, None, make_filter, tick=tick, blind=True), self._adversary(seed)
            else:
                period, goal = period_of(policy, task), goal_for(policy, task)
                robot = TrialRobot(world, None, make_filter, tick=tick, period=period, goal=goal)
                driver = PolicyDriver(policy)
            (episode,) = drive(robot, driver, seeds=(seed,))
            return trial_outcome(episode)
        finally:
            world.close()

    def _adversary(self, seed: int) -> Driver[Sensors]:
        if self._cell.source == "full_speed":
            return Constant(np.full(2, self._model.most))
        return RandomThrusts(self._model, seed, FlightOptions().tick)

    def _guard(self, world: SimulatedWorld) -> GuardFilter:
        model = self._model
        if self._cell.guard == "mismatch":
            mass = _LIGHTER * model.mass
            model = replace(model, mass=mass, disturbance=2.0 * model.most * (1.0 / mass - 1.0 / model.mass))
        shapes = (*world.geometry.walls, *world.geometry.obstacles)
        goal = self._task.goal.region if self._policy is not None else None
        return GuardFilter(FlightGuard(model, shapes, goal=goal))
