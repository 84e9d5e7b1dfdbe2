"""Refits a latent policy to recorded drives: encoder and law stay, model and regulator are recomputed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.data.roll_outs import Episode, projected
from koopman_lqr_controller.data.trajectory_segments import TrajectorySegment, mean_time_step
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.identification.regulators import RegulatorFitter
from koopman_lqr_controller.models.encoder import Dense
from koopman_lqr_controller.policies.latent_policy import LatentPolicy
from koopman_lqr_controller.safety.guards import fit_distribution_to_episodes

SIZES = (4, 8, 16, 1000)
"""Latent dimensions to try; larger ones than the encoder's stand for all of its dimensions."""
_SAME_LAW = 0.1
"""Maximum mismatch at which a regulator counts as equivalent to the policy; 0 for the same law."""

_STAYS = ("task", "task_digest")
"""Manifest keys kept by a refit; all others describe the former policy."""


def refit(policy: LatentPolicy, segments: Sequence[TrajectorySegment], sizes: Sequence[int] = SIZES) -> LatentPolicy:
    """Fit a model to recorded drives and return a regulator equivalent to the policy, with the region of the drives.

    Among projections with an equivalent regulator, the one with the best cross-validated prediction is chosen.

    Args:
        policy: Latent policy of a lidar robot.
        segments: Segments with the policy's observations x, and commands.
        sizes: Latent dimensions to try.

    Raises:
        KoopmanError: The policy has another task, the drives are too short, or no model has a regulator.
    """
    learnt = _unprojected(policy.controller)
    if not segments:
        raise KoopmanError("no drive to fit")
    episodes = [_episode(learnt, policy, segment) for segment in segments]
    mirrored = [_episode(learnt, policy, _mirrored(policy, segment)) for segment in segments]
    found = RegulatorFitter(learnt, episodes, mirrored, goal=bool(learnt.z_ref.any()))
    candidates = (found.regulator(family, C) for family, C in found.projections(sizes))
    tried = [each for each in candidates if each is not None]
    if not tried:
        raise KoopmanError(
            "no regulator: the refitted model cannot be stabilised; record a drive with more varied commands"
        )
    same = [each for each in tried if each.mismatch <= _SAME_LAW]
    chosen = (
        min(same, key=lambda each: each.shrunk.cross_validation_error)
        if same
        else min(tried, key=lambda each: each.mismatch)
    )
    controller = chosen.controller
    distribution = fit_distribution_to_episodes(
        controller.predict, *projected(controller.project, [*episodes, *mirrored])
    )
    figures = {
        "latent": len(controller.Q),
        "family": chosen.family,
        "mismatch": chosen.mismatch,
        "action_difference": _difference(controller, learnt, episodes),
        "contraction": chosen.contraction,
        "ridge": chosen.shrunk.ridge,
        "cross_validated_error_over_persistence": chosen.shrunk.cross_validation_error,
        "spectral_radius": controller.spectral_radius,
        "dare_residual": controller.residual,
    }
    manifest = {name: policy.manifest[name] for name in _STAYS if name in policy.manifest} | figures
    return LatentPolicy(controller, mean_time_step(segments), policy.robot_interface, manifest, distribution)


def _episode(learnt: LatentController, policy: LatentPolicy, segment: TrajectorySegment) -> Episode:
    """Convert a drive to an episode without rewards."""
    actions = policy.to_controls(segment.u)
    none: dict[str, Any] = {}
    return Episode(learnt.encoder(segment.x), actions, float("nan"), len(actions), 0.0, none)


def _difference(controller: LatentController, learnt: LatentController, episodes: Sequence[Episode]) -> float:
    """Return the root mean square difference between the actions of two controllers, which span 2."""
    psi = np.concatenate([episode.features for episode in episodes])
    done, wanted = (each.saturate(each.control(each.project(psi))) for each in (controller, learnt))
    return float(np.sqrt(np.mean((done - wanted) ** 2)))


def _mirrored(policy: LatentPolicy, segment: TrajectorySegment) -> TrajectorySegment:
    """Return a drive with left and right swapped."""
    order, sign = policy.required_interface.observation.mirror
    return TrajectorySegment(segment.x[:, order] * sign, segment.u * (1.0, -1.0), segment.dt)


def _unprojected(controller: LatentController) -> LatentController:
    """Return the same controller with its projection as the last layer of the encoder."""
    if controller.projection is None:
        return controller
    weight = controller.projection.astype(np.float32)
    last = Dense(weight, np.zeros(len(weight), np.float32), False)
    encoder = replace(controller.encoder, layers=(*controller.encoder.layers, last))
    return replace(controller, encoder=encoder, projection=None)
