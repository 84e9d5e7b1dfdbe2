"""Linearisation of the true system behind a policy, with and without the policy in the loop (thesis Fig. 4.6)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core import ScanGeometry
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.control.linear_analysis import Poles, jacobian, linearise, poles
from koopman_lqr_controller.policies.latent_policy import LatentPolicy
from koopman_lqr_controller.policies.policy_file import KoopmanPolicy
from koopman_lqr_controller.training.environments.control_suite import ControlSuite

_BEAMS = 360


@dataclass(frozen=True)
class StraightCorridor:
    """A unicycle that executes commands immediately. State: lateral offset [m], heading [rad], speed, turn rate.

    The position along the corridor is irrelevant and omitted.

    Attributes:
        width: Distance between the walls [m].
        dt: Hold time of a command [s].
        range_max: Maximum range of the lidar, mounted at the robot's centre [m].
    """

    width: float
    dt: float
    range_max: float = 3.5

    def step(self, state: Array, command: Array) -> Array:
        """Return the next state (4,) under a command (2,): speed [m/s], turn rate [rad/s]."""
        offset, heading, (v, omega) = float(state[0]), float(state[1]), command
        turned = 0.5 * omega * self.dt
        # The chord of an arc, with NumPy's sinc, sin(pi x) / (pi x).
        return np.array(
            [
                offset + v * self.dt * np.sinc(turned / np.pi) * np.sin(heading + turned),
                heading + omega * self.dt,
                v,
                omega,
            ]
        )

    @property
    def geometry(self) -> ScanGeometry:
        """Geometry of the lidar."""
        return ScanGeometry(_BEAMS, 0.0, 2.0 * np.pi / _BEAMS, 0.0, self.range_max)

    def scan(self, state: Array) -> NDArray[np.float32]:
        """Return the exact ranges (beams,) [m]; infinite if the wall is out of range."""
        across = np.sin(np.arange(_BEAMS) * (2.0 * np.pi / _BEAMS) + state[1])
        gap = np.where(across > 0.0, 0.5 * self.width - state[0], 0.5 * self.width + state[0])
        ranges = gap / np.maximum(np.abs(across), 1e-9)
        return np.where(ranges > self.range_max, np.inf, ranges).astype(np.float32)


Step = Callable[[Array], Array]

_SETTLING = 400
"""Number of steps within which a closed loop must come to rest."""
_AT_REST = 1e-4
"""Change per step below which a state counts as at rest; encoders are single precision."""
_CLOSED_SIZE = 2e-3
"""Step size for the closed loop: large compared with the encoder's rounding, small compared with nonlinearity."""
_RESTLESS = "With the policy the real system does not come to rest within the steps that were tried."
_PICTURES = "With the policy there are none: it sees pictures, and small differences of a state change no pixel."


@dataclass(frozen=True)
class TrueSystem:
    """Result of a linearisation.

    Attributes:
        about: Name of the linearised system.
        open_poles: Poles without the policy (n,).
        closed_poles: Poles with the policy, around its rest state (n,), or None.
        rest: Rest state (n,), or None.
        why: Reason why there are no closed-loop poles, as a sentence; empty otherwise.
    """

    about: str
    open_poles: Poles
    closed_poles: Poles | None
    rest: Array | None
    why: str = ""


def suite_system(environment: ControlSuite, goal: Array, policy: LatentPolicy) -> TrueSystem:
    """Linearise a control suite task at its goal, without and with a policy that observes states.

    Args:
        environment: Environment of the task.
        goal: Goal positions and velocities (n,), an equilibrium.
        policy: Policy in the loop.
    """

    def held(state: Array, action: Array) -> Array:
        environment.place(state)
        environment.step(action.astype(np.float32))
        return environment.state

    def closed(state: Array) -> Array:
        action = policy.controller.action(environment.place(state))
        environment.step(action.astype(np.float32))
        return environment.state

    controls = np.zeros(len(policy.controller.R))
    about, found = "the simulated system at its goal", linearise(held, goal, controls, 1e-6)
    if len(policy.controller.encoder.shape) > 1:
        return TrueSystem(about, poles(found.A), None, None, _PICTURES)
    return _with_loop(about, poles(found.A), closed, goal)


def corridor_system(policy: KoopmanPolicy, width: float, dt: float, speed: float) -> TrueSystem:
    """Linearise a unicycle with a lidar at the centre of a straight corridor.

    Args:
        policy: Policy in the loop.
        width: Width of the corridor [m].
        dt: Hold time of a command [s].
        speed: Speed of the linearisation without the policy [m/s].
    """
    corridor = StraightCorridor(width, dt)

    def closed(state: Array) -> Array:
        scan = corridor.scan(state)
        return corridor.step(state, policy.decide(scan, corridor.geometry, state[2], state[3]).command)

    middle = np.array([0.0, 0.0, speed, 0.0])
    found = linearise(corridor.step, middle, middle[2:])
    return _with_loop(f"a unicycle in the middle of a straight corridor of {width:g} m", poles(found.A), closed, middle)


def _with_loop(about: str, open_poles: Poles, closed: Step, begin: Array) -> TrueSystem:
    state = begin
    for _ in range(_SETTLING):
        after = closed(state)
        moved, state = float(np.abs(after - state).max()), after
        if moved < _AT_REST:
            break
    else:
        return TrueSystem(about, open_poles, None, None, _RESTLESS)
    found = jacobian(lambda states: np.array([closed(each) for each in states]), state, _CLOSED_SIZE)
    return TrueSystem(about, open_poles, poles(found), state)
