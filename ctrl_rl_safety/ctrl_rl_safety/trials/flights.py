"""Episodes of a planar quadrotor, by an adversary or a policy, with and without its guard."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from ctrl_rl_core.policies.policy import Policy
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Outcome, find_policy, load_policy, task_digest
from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.flight.flight_guard import FlightGuard, FlightOptions
from ctrl_rl_safety.models.quadrotor_model import QuadrotorModel, quadrotor_of
from ctrl_rl_safety.trials.episodes import Cell, TrialOutcome
from ctrl_rl_safety.trials.sources import Driver, Source
from sim_bridge import SimulatedWorld, SimulationOptions

Array = NDArray[np.float64]

ADVERSARIES = ("full_speed", "random")
GUARDS = ("none", "filter", "mismatch")
"""With `mismatch` the guard takes the quadrotor for 3 % lighter than it is, and is told by how much it then may err."""
_LIGHTER = 0.97
_RATE = 240
_HELD_S = (0.05, 0.5)


class FullThrust:
    """All the thrust that there is, whatever is there."""

    def __init__(self, model: QuadrotorModel) -> None:
        self._thrusts = np.full(2, model.most)

    def command(self, world: SimulatedWorld) -> tuple[Array, float]:  # noqa: ARG002, D102 - see Source
        return self._thrusts, 0.2


class RandomThrusts:
    """Random thrusts, each for a random time; half of them equal, so that it flies as well as tumbles."""

    def __init__(self, model: QuadrotorModel, seed: int) -> None:
        self._least, self._most = model.least, model.most
        self._random = np.random.default_rng((seed, 9))

    def command(self, world: SimulatedWorld) -> tuple[Array, float]:  # noqa: ARG002, D102 - see Source
        thrusts = self._random.uniform(self._least, self._most, 2)
        if self._random.random() < 0.5:
            thrusts[1] = thrusts[0]
        return thrusts, round(20.0 * self._random.uniform(*_HELD_S)) / 20.0


class FlightPlayer:
    """Plays the episodes of a cell whose task flies.

    A policy flies to a goal at which the episode ends: its guard is told so, and lets it arrive as fast as it likes.
    Behind an adversary the guard keeps the quadrotor safe for ever.
    """

    def __init__(self, cell: Cell, engine: str, task: NavigationTask) -> None:
        """Load what all episodes need.

        Args:
            cell: Who commands, and with which guard.
            engine: Physics engine, one of `sim_bridge.ENGINES`.
            task: Task of the cell.

        Raises:
            CtrlRlError: There is no such policy, it is for another kind of robot, or there is no such guard of flights.
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
        """What its episodes depend on, as text."""
        return [repr(self._model), repr(FlightOptions()), task_digest(self._task)]

    def play(self, seed: int) -> TrialOutcome:
        """Return the end of the episode of a seed."""
        world = SimulatedWorld(self._task, seed, options=self._options)
        try:
            return self._fly(world, self._source(seed), self._guard(world))
        finally:
            world.close()

    def _source(self, seed: int) -> Source:
        if self._policy is not None:
            return Driver(self._policy, self._task)
        return FullThrust(self._model) if self._cell.source == "full_speed" else RandomThrusts(self._model, seed)

    def _guard(self, world: SimulatedWorld) -> FlightGuard | None:
        if self._cell.guard == "none":
            return None
        model = self._model
        if self._cell.guard == "mismatch":
            mass = _LIGHTER * model.mass
            model = replace(model, mass=mass, disturbance=2.0 * model.most * (1.0 / mass - 1.0 / model.mass))
        shapes = (*world.geometry.walls, *world.geometry.obstacles)
        goal = self._task.goal.region if self._policy is not None else None
        return FlightGuard(model, shapes, goal=goal)

    def _fly(self, world: SimulatedWorld, source: Source, guard: FlightGuard | None) -> TrialOutcome:
        tick = FlightOptions().tick
        steps = round(tick * _RATE)
        ticks = changed = 0
        distance = 0.0
        while world.episode().outcome is Outcome.RUNNING:
            raw, seconds = source.command(world)
            for _ in range(max(1, round(seconds / tick))):
                thrusts = raw
                if guard is not None:
                    verdict = guard.decide(world.measured_state(), raw)
                    thrusts = verdict.thrusts
                    changed += verdict.changed
                ticks += 1
                before = world.pose()
                world.command(0, thrusts)
                world.step(steps)
                distance += math.dist(before[:2].tolist(), world.pose()[:2].tolist())
                if world.episode().outcome is not Outcome.RUNNING:
                    break
        end = world.episode().outcome
        hit = end is Outcome.COLLISION  # or tilted over
        return TrialOutcome(
            world.seed, end.name, round(world.elapsed, 4), hit, False, changed / ticks, round(distance, 4)
        )
