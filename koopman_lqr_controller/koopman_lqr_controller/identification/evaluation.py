"""Metrics of a policy on recorded drives: prediction errors, and differences between commands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from koopman_lqr_controller.data.trajectory_segments import TrajectorySegment, mean_time_step
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.prediction import HORIZON, horizon_errors
from koopman_lqr_controller.policies.policy_file import KoopmanPolicy
from koopman_lqr_controller.sensing.lidar_observation import STEP_TOLERANCE

_COMMANDS = ("speed [m/s]", "turn rate [rad/s]")


def evaluate_policy(policy: KoopmanPolicy, segments: Sequence[TrajectorySegment]) -> dict[str, Any]:
    """Return metrics of a policy on drives, as JSON.

    Returns:
        `steps`; `over_persistence`, the prediction error relative to persistence after 1, 2, ... steps; `commands`, for
        each the root mean square difference between the policy's and the recorded command, that of the recorded command
        from its mean, and the fraction of its variance explained by the policy (1 - squared ratio of the two).

    Raises:
        KoopmanError: There are no steps, or the policy's task has no lidar.
    """
    if not segments:
        raise KoopmanError("no steps to evaluate on")
    loop = policy.closed_loop_model()
    z = [loop.latent(segment.x) for segment in segments]
    errors = horizon_errors(loop.predict, z, [policy.to_controls(segment.u) for segment in segments], HORIZON)
    given = np.concatenate([segment.u for segment in segments])
    own = np.concatenate([policy.to_commands(loop.control(each[:-1])) for each in z])
    missed = np.sqrt(np.mean((own - given) ** 2, axis=0))
    spread = given.std(axis=0)
    return {
        "steps": len(given),
        "over_persistence": errors,
        "commands": {
            name: {
                "difference": float(missed[index]),
                "spread": float(spread[index]),
                "explained": float(1.0 - (missed[index] / spread[index]) ** 2) if spread[index] > 0.0 else None,
            }
            for index, name in enumerate(_COMMANDS)
        },
    }


def time_step_mismatch(policy: KoopmanPolicy, segments: Sequence[TrajectorySegment]) -> str:
    """Return a warning if a policy's model and the drives have different time steps; empty otherwise."""
    step = mean_time_step(segments)
    if policy.dt is None or abs(step / policy.dt - 1.0) < STEP_TOLERANCE:
        return ""
    return f"The model's step is {policy.dt:.2f} s, that of the drives {step:.2f} s: `fit` makes a model of theirs."
