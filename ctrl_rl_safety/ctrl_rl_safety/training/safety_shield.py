"""The safety filter for any Gymnasium environment of a wheeled robot.

    robot = dataclasses.replace(find_model("turtlebot3_burger"), delay=0.0, lag=0.0)     # as in this simulator
    environment = SafetyShield(mine, robot, step=0.1, state="state", scan=lambda seen: seen[:360], bearings=angles)

The filter answers once per step. For the suite's own worlds, `Shield` answers several times per step.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from ctrl_rl_core.systems import NumberReader, Source, reader_of
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_safety.errors import SafetyError
from ctrl_rl_safety.filter.evidence import beams_at
from ctrl_rl_safety.filter.safety_filter import SafetyFilter
from ctrl_rl_safety.filter.verdict import FilterOptions, Mode, Reading
from ctrl_rl_safety.models.robot_model import RobotModel, find_model

Array = NDArray[np.float64]
_STATE = ("x [m]", "y [m]", "theta [rad]", "v [m/s]", "omega [rad/s]")
_LONGEST_STEP = 1.0


class SafetyShield(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Passes an action as long as the robot can provably still stop; otherwise sends the nearest safe one.

    The guarantee requires correct robot constants: the simulator must accelerate, brake and turn at least as well as
    stated, with no more delay, and `scan` must show every obstacle. Episodes must start in a state from which the robot
    can still stop. `info` then has

    - `told_action`, the action sent in place of the learner's own;
    - `changed`, 1.0 if the filter changed the action, else 0.0;
    - `filter_mode`, the filter's mode (PASSED, CORRECTED, ESCAPING, UNBLOCKING or EVADING).

    >>> import ctrl_rl, gymnasium, numpy as np
    >>> class Aisle(gymnasium.Env):                     # a robot in front of a wall at x = 1 m
    ...     observation_space = gymnasium.spaces.Box(-9.0, 9.0, (1,))
    ...     action_space = gymnasium.spaces.Box(np.array([-0.22, -2.84]), np.array([0.22, 2.84]))
    ...     def reset(self, *, seed=None, options=None):
    ...         super().reset(seed=seed)
    ...         self.x = 0.0
    ...         return np.zeros(1, np.float32), {"state": [0.0, 0.0, 0.0, 0.0, 0.0]}
    ...     def step(self, action):
    ...         self.x += 0.1 * float(action[0])
    ...         info = {"state": [self.x, 0.0, 0.0, float(action[0]), 0.0]}
    ...         return np.array([self.x], np.float32), 0.0, self.x > 0.877, False, info
    >>> def wall(observation):
    ...     return np.stack((np.full(81, 1.0 - observation[0]), np.linspace(-2.0, 2.0, 81)), axis=1)
    >>> env = ctrl_rl.SafetyShield(Aisle(), "turtlebot3_burger", step=0.1, state="state", scan=wall)
    >>> _ = env.reset()
    >>> steps = [env.step(np.array([0.22, 0.0])) for _ in range(60)]
    >>> any(terminated for _, _, terminated, _, _ in steps), steps[-1][-1]["changed"]
    (False, 1.0)
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        robot: RobotModel | str,
        *,
        step: float,
        state: Source,
        scan: Source,
        bearings: ArrayLike | None = None,
        commands: ArrayLike | None = None,
        mover_speed: float = 0.0,
        recoverable_set: bool = False,
    ) -> None:
        """Wrap an environment.

        Args:
            env: Environment of one robot whose action is a box of two numbers, for speed and turn rate.
            robot: Constants of the simulated robot: a name, a YAML file or a `RobotModel`. Set `delay` and `lag` to 0
                for a simulator without them.
            step: Duration of a step of the environment [s].
            state: Source of x, y, theta, v, omega (5,), in SI units and any fixed frame: a key of `info`, a function of
                the observation, or a function of the observation and `info`.
            scan: Source of the scan: ranges (n,) [m] at `bearings`, where non-finite ranges mean no echo; or without
                `bearings` the echoes themselves (n, 2) in the robot's frame [m], in bearing order.
            bearings: Bearings (n,) of the ranges in the robot's frame [rad].
            commands: Minimum and maximum speed [m/s] and turn rate [rad/s], ((v, v), (omega, omega)), at the bounds of
                the action; by default, actions are commands in SI units.
            mover_speed: Maximum speed of movers [m/s].
            recoverable_set: Whether to solve the recoverable set in each step, which takes milliseconds and passes more
                commands in tight places.

        Raises:
            SafetyError: An argument is invalid.
        """
        super().__init__(env)
        space = env.action_space
        if not isinstance(space, spaces.Box) or space.shape != (2,):
            raise SafetyError(f"the action is {space}: must be a box of two numbers, for speed and turn rate")
        if not 0.0 < step <= _LONGEST_STEP:
            raise SafetyError(f"step {step} s: must be more than 0 and at most {_LONGEST_STEP:g}")
        self._low, self._high = np.asarray(space.low, float), np.asarray(space.high, float)
        self._bounds = None if commands is None else self._checked(np.asarray(commands, float))
        self._model = find_model(robot) if isinstance(robot, str) else robot
        self._step, self._with_set = float(step), recoverable_set
        self._options = FilterOptions(period=self._step, mover_speed=mover_speed)
        self._state = NumberReader(state, _STATE, "state", SafetyError)
        self._scan = reader_of(scan)
        self._bearings = None if bearings is None else np.asarray(bearings, float)
        self._filter: SafetyFilter | None = None
        self._now, self._reading = 0.0, Reading(np.zeros(3), 0.0, 0.0)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode; the filter is reset to its first scan."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._filter, self._now = SafetyFilter(self._model, self._options), 0.0
        self._see(self._filter, observation, info)
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step with the action, or with the nearest one that passes the filter.

        Raises:
            SafetyError: The environment was not reset, or the action, state or scan is not finite.
        """
        if self._filter is None:
            raise SafetyError("reset the environment before its first step")
        raw = self._command_of(action)
        verdict = self._filter.decide(self._now, self._reading, raw)
        self._filter.sent(self._now, verdict.command)
        passed = verdict.mode is Mode.PASSED
        sent = np.asarray(action) if passed else self._action_of(verdict.command)
        observation, reward, terminated, truncated, info = self.env.step(sent)
        self._now += self._step
        self._see(self._filter, observation, info)
        told = {"told_action": sent, "changed": float(not passed), "filter_mode": verdict.mode.name}
        return observation, reward, terminated, truncated, {**info, **told}

    def _see(self, safety: SafetyFilter, observation: Any, info: Mapping[str, Any]) -> None:
        x, y, theta, v, omega = self._state(observation, info).tolist()
        self._reading = Reading(np.array((x, y, theta)), v, omega)
        scan = np.asarray(self._scan(observation, info), float)
        echoes = self._echoes(scan)
        beams = None if self._bearings is None else beams_at(self._bearings, scan)
        safety.see(self._now, self._reading.pose, echoes, beams=beams)
        if self._with_set:
            safety.use(safety.solve())

    def _echoes(self, scan: Array) -> Array:
        """Return the echoes (n, 2) in the robot's frame [m]."""
        if self._bearings is None:
            if scan.ndim != 2 or scan.shape[1] != 2 or not np.isfinite(scan).all():
                raise SafetyError(f"scan of the shape {scan.shape}: must be echoes (n, 2) of finite numbers; give "
                                  "bearings for ranges (n,)")  # fmt: skip
            return scan
        if scan.shape != self._bearings.shape:
            raise SafetyError(f"scan of the shape {scan.shape}: must have a range for each of the bearings, "
                              f"{self._bearings.shape}")  # fmt: skip
        seen = np.isfinite(scan)
        directions = np.stack((np.cos(self._bearings[seen]), np.sin(self._bearings[seen])), axis=1)
        return np.asarray(scan[seen, None] * directions)

    def _checked(self, commands: Array) -> Array:
        if commands.shape != (2, 2) or not np.isfinite(commands).all() or not (commands[:, 0] < commands[:, 1]).all():
            raise SafetyError(f"commands {commands.tolist()}: must be ((least v, largest v), (least omega, largest "
                              "omega))")  # fmt: skip
        if not (np.isfinite(self._low).all() and np.isfinite(self._high).all()):
            raise SafetyError("the action has no bounds that commands could stand for: leave commands out")
        return commands

    def _command_of(self, action: Any) -> Array:
        """Convert an action (2,) to speed and turn rate (2,), within the bounds."""
        given = np.asarray(action, float)
        if given.shape != (2,) or not all(map(math.isfinite, given.tolist())):
            raise SafetyError(f"action {given.tolist()}: must be two finite numbers")
        given = np.clip(given, self._low, self._high)
        if self._bounds is None:
            return given
        low, high = self._bounds.T
        return np.asarray(low + (given - self._low) / (self._high - self._low) * (high - low))

    def _action_of(self, command: Array) -> NDArray[Any]:
        """Convert a command (2,) to an action (2,), in the type of the action space."""
        action = command
        if self._bounds is not None:
            low, high = self._bounds.T
            action = self._low + (command - low) / (high - low) * (self._high - self._low)
        return np.clip(action, self._low, self._high).astype(self.env.action_space.dtype)
