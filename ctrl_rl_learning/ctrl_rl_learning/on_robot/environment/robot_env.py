"""The robot as a Gymnasium environment, and the clock of its steps."""

from __future__ import annotations

from typing import Any, NamedTuple

import gymnasium
import numpy as np
from ctrl_rl_core.policies import ObservationBuilder
from gymnasium import spaces
from numpy.typing import NDArray

from ctrl_rl_core import NavigationTask, Outcome, PolicyManifest, TaskSets
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.on_robot.environment.rewards import StateReader, StepReward
from ctrl_rl_learning.on_robot.environment.robot import Driven, Robot, StepEnd

_ROUNDING_S = 1e-6


class StepTiming(NamedTuple):
    """Timing of one step.

    Attributes:
        duration: Time from the start of the step to its end [s].
        late: Delay of the end after the due time [s].
        missed: Number of whole steps that passed without a decision.
    """

    duration: float
    late: float
    missed: int


class StepClock:
    """Clock of equally long steps in the robot's time.

    A step that ends slightly late shortens the next one, so that steps do not drift. After a missed step the clock
    restarts from the current time instead of catching up with short steps.

    Attributes:
        period: Length of a step [s].
        due: Time at which the current step ends [s].
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self._begun = 0.0
        self.due = period

    def begin(self, now: float) -> None:
        """Begin the first step of an episode at a time [s]."""
        self._begun, self.due = now, now + self.period

    def end(self, now: float) -> StepTiming:
        """End the current step at a time [s] and begin the next one.

        Raises:
            LearningError: The clock was set back.
        """
        duration = now - self._begun
        if duration < 0.0:
            raise LearningError(f"the clock went back by {-duration:.3f} s: was the simulator restarted?")
        late = max(now - self.due, 0.0)
        missed = int((late + _ROUNDING_S) / self.period)
        self.due = now + self.period if missed else self.due + self.period
        self._begun = now
        return StepTiming(duration, late, missed)


Vector = NDArray[np.float32]
_FENCE_M = 0.5


class RobotEnv(gymnasium.Env[Vector, Vector]):
    """One robot that drives a task behind its safety filter, timed by the robot's clock.

    Observation: the same vector as the policy node builds from the interface. Action: [-1, 1] for each command, mapped
    to the interface's limits. An episode terminates at the goal, in a collision or in a trap, as reported by simulator
    or operator or as the pose shows. It is truncated after the task's number of steps (`TIMEOUT`) or outside the arena,
    corridor or map ("FENCE").

    Info of each step: `action` (2,), the mean action sent to the filter, the operator's included; `operator`, the
    fraction of the step that the operator drove; `changed`, the fraction of commands that the filter changed;
    `duration`, `late` [s] and `missed` steps of the clock; `age` of the scan [s]; `late_scans`; `outcome`, a name of
    ctrl_rl_core.Outcome or "FENCE".
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - gymnasium's own form

    def __init__(self, robot: Robot, task: NavigationTask, interface: PolicyManifest, reward: StepReward) -> None:
        """Create the environment.

        Args:
            robot: Robot to drive.
            task: Task with goal, arena and episode length.
            interface: Observation and commands of the policy.
            reward: Reward of each step.

        Raises:
            LearningError: The interface is not for a wheeled robot.
        """
        if interface.robot != "differential_drive" or interface.action.choices is not None:
            raise LearningError("only policies with commands v and omega learn on a robot")
        self.render_mode = None
        self._robot, self._task, self._reward = robot, task, reward
        self._observe = ObservationBuilder(interface)
        self._low, self._high = np.array(interface.action.low), np.array(interface.action.high)
        self._clock = StepClock(interface.period or task.episode.time_step)
        self._state_of = StateReader(task.system.build().state_names)
        self._sets, self._bounds = TaskSets(task), tuple(task.plane_bounds.values())
        self._steps = 0
        self.observation_space = spaces.Box(-np.inf, np.inf, (interface.size,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    @property
    def period(self) -> float:
        """Length of a step [s]."""
        return self._clock.period

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Vector, dict[str, Any]]:
        """Reset the robot to a start, which a simulator draws from the seed or an operator chooses.

        Raises:
            LearningError: The robot, its simulator or its safety filter does not answer.
        """
        super().reset(seed=seed, options=options)
        drawn = int(self.np_random.integers(2**31)) if seed is None else seed
        reading = self._robot.begin(drawn)
        self._steps = 0
        self._reward.begin(self._state_of(reading.sensors))
        self._clock.begin(self._robot.now())
        return self._observe(reading.sensors), {"age": reading.sensors.age, "outcome": Outcome.RUNNING.name}

    def step(self, action: Vector) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Apply an action (2,) until the step ends.

        Raises:
            LearningError: The robot, its simulator or its safety filter does not answer; the robot is stopped first.
        """
        share = 0.5 * (np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0) + 1.0)
        try:
            driven = self._robot.drive(self._low + share * (self._high - self._low), self._clock.due)
            timing = self._clock.end(self._robot.now())
            reading = self._robot.read()
        except LearningError:
            self._robot.stand()
            raise
        self._steps += 1
        state = self._state_of(reading.sensors)
        outcome = reading.outcome
        if outcome is None:
            outcome = Outcome.GOAL if self._sets.in_goal(state) else Outcome.RUNNING
        fenced = outcome is Outcome.RUNNING and not self._inside(state)
        late = outcome is Outcome.RUNNING and self._steps >= self._task.episode.steps
        truncated = fenced or late or outcome is Outcome.TIMEOUT
        terminated = outcome not in (Outcome.RUNNING, Outcome.TIMEOUT)
        if terminated or truncated:
            self._robot.stand()
        reward = self._reward.step(state, outcome)
        info = self._info(driven, timing, reading)
        info["outcome"] = "FENCE" if fenced else (Outcome.TIMEOUT if late else outcome).name
        return self._observe(reading.sensors), reward, terminated, truncated and not terminated, info

    def close(self) -> None:
        """Stop the robot."""
        self._robot.stand()

    def _inside(self, state: NDArray[np.float64]) -> bool:
        """Return whether the robot is within the task's walls, with a margin for the drift of odometry."""
        return all(
            side.low - _FENCE_M <= place <= side.high + _FENCE_M
            for side, place in zip(self._bounds, state[:2], strict=True)
        )

    def _info(self, driven: Driven, timing: StepTiming, reading: StepEnd) -> dict[str, Any]:
        span = self._high - self._low
        return {
            "action": (2.0 * (driven.command - self._low) / span - 1.0).clip(-1.0, 1.0).astype(np.float32),
            "operator": driven.operator,
            "changed": driven.changed,
            "duration": timing.duration,
            "late": timing.late,
            "missed": timing.missed,
            "age": reading.sensors.age,
            "late_scans": reading.late_scans,
        }
