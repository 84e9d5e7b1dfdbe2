"""The two-stage, model-oriented Koopman controller (thesis 2.3.1): first the model by EDMD, then its LQR."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any

import numpy as np

from ctrl_rl_core import Interval
from koopman_lqr_controller.control.riccati import solve_lqr
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import Snapshots, fit, persistence_error
from koopman_lqr_controller.models.identifiability import RegressionData, check_controls_move
from koopman_lqr_controller.models.shrinkage import fit_with_shrinkage
from koopman_lqr_controller.policies.edmd_policy import EdmdPolicy
from koopman_lqr_controller.safety.guards import fit_distribution
from koopman_lqr_controller.sensing.observables import CorridorObservables

_COMMANDS = ("the commanded speed", "the commanded turn rate")


@dataclass(frozen=True)
class Weights:
    """Hand-tuned quadratic cost, the step that task-oriented learning replaces.

    Attributes:
        side: Weight on the lateral offset.
        ahead: Weight on facing a wall.
        speed: Weight on the squared speed error [s^2/m^2].
        acceleration: Weight on the squared deviation of the commanded speed [s^2/m^2].
        turning: Weight on the squared turn rate [s^2/rad^2].
    """

    side: float = 1.0
    ahead: float = 1.0
    speed: float = 10.0
    acceleration: float = 10.0
    turning: float = 0.5


def train(
    sequences: Sequence[Snapshots],
    observables: CorridorObservables,
    speed: float,
    limits: tuple[Interval, Interval],
    weights: Weights | None = None,
    held_out: float = 0.2,
    manifest: dict[str, Any] | None = None,
    shrunk: bool = False,
) -> EdmdPolicy:
    """Fit model and regulator and return the policy, with metrics in its manifest.

    Args:
        sequences: Snapshots of one or more drives; the last part is held out for evaluating the model.
        observables: Observables Psi of a scan and odometry.
        speed: Driving speed [m/s].
        limits: Limits of the speed [m/s] and the turn rate [rad/s].
        weights: Weights of the cost; the default ones if omitted.
        held_out: Fraction of the snapshots held out for the evaluation, 0 <= held_out < 1.
        manifest: Further content of the policy's manifest.
        shrunk: Whether the model is shrunk towards persistence, for scarce and noisy data.

    Raises:
        KoopmanError: The speed exceeds the limits, the data is insufficient to identify the effect of the commands, or
            there is no stabilising regulator.
    """
    if not limits[0].low <= speed <= limits[0].high:
        raise KoopmanError(f"the driving speed is {speed} m/s: must be from {limits[0].low} to {limits[0].high}")
    if not sequences:
        raise KoopmanError("no snapshots: record a drive first")
    for each in sequences:
        if RegressionData.of(each.z, each.u, each.z_next).shape != (len(observables.names), len(_COMMANDS)):
            raise KoopmanError(
                f"snapshots have z {each.z.shape} and u {each.u.shape}: must have {len(observables.names)} observables "
                f"and {len(_COMMANDS)} commands"
            )
    weights = weights or Weights()
    seen, unseen = _split(reduce(add, sequences), held_out)
    z_ref = np.zeros(len(observables.names))
    z_ref[-1] = speed
    u_ref = np.array([speed, 0.0])
    check_controls_move(seen.u, _COMMANDS)
    # The mirrored drive is equally valid, and makes the model symmetric.
    data = seen.centred(z_ref, u_ref)
    mirrored = data.mirrored(observables.mirror, np.array([1.0, -1.0]))
    if shrunk:
        model = fit_with_shrinkage(data, mirrored, drift=False, lifted=True).model
    else:
        model = fit(data + mirrored, lifted=True)
    constant = [
        name
        for name, here, there in zip(observables.names, data.z.T, data.z_next.T, strict=True)
        if np.ptp(here) == 0.0 and np.ptp(there) == 0.0
    ]
    Q = np.diag(observables.state_cost(weights.side, weights.ahead, weights.speed))
    R = np.diag([weights.acceleration, weights.turning])
    regulator = solve_lqr(model, Q, R)
    test = unseen.centred(z_ref, u_ref)
    both = np.vstack((seen.z, seen.z * observables.mirror))
    distribution = fit_distribution(both, np.linalg.norm(test.z_next - model.predict(test.z, test.u), axis=1))
    error, persistence = model.one_step_error(test), persistence_error(test)
    figures = {
        "method": "EDMD and infinite-horizon LQR, two stages (thesis 2.3.1)",
        "speed": speed,
        "weights": vars(weights),
        "constant_observables": constant,
        "snapshots": {"fitted": len(seen), "held_out": 0 if unseen is seen else len(unseen)},
        "one_step_error": error.tolist(),
        "persistence_error": persistence.tolist(),
        "error_over_persistence": float(np.linalg.norm(error) / np.linalg.norm(persistence)),
        "spectral_radius": regulator.spectral_radius,
        "dare_residual": regulator.residual,
    }
    low, high = np.array(limits).T
    return EdmdPolicy(
        observables,
        model,
        regulator.K,
        regulator.P,
        z_ref,
        u_ref,
        low,
        high,
        {**(manifest or {}), **figures},
        distribution,
    )


def _split(data: Snapshots, held_out: float) -> tuple[Snapshots, Snapshots]:
    """Split off the last part; if nothing is held out, the evaluation uses the fitted data."""
    cut = len(data) - round(held_out * len(data))
    if cut == len(data):
        return data, data
    return (
        Snapshots(data.z[:cut], data.u[:cut], data.z_next[:cut]),
        Snapshots(data.z[cut:], data.u[cut:], data.z_next[cut:]),
    )
