"""A latent policy refitted to recorded drives: its encoder and law stay, its model and regulator are made anew."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koopman_lqr_controller.drives import Drive
from koopman_lqr_controller.edmd import LinearModel, Snapshots
from koopman_lqr_controller.encoder import Dense
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.latent_controller import LatentController
from koopman_lqr_controller.latent_policy import LatentPolicy
from koopman_lqr_controller.linear_loop import controls_of, wiring_of
from koopman_lqr_controller.region import region_of_episodes
from koopman_lqr_controller.regulators import Refit, Regulator
from koopman_lqr_controller.roll_outs import Episode, projected
from koopman_lqr_controller.shrinkage import Shrunk, fit_shrunk

Array = NDArray[np.float64]

SIZES = (4, 8, 16, 1000)
"""Latent dimensions that are tried; those beyond the encoder's own stand for all of them."""
_SAME_LAW = 0.1
"""Mismatch up to which a regulator does what the policy does, see `Law.mismatch`."""


class OfflineRefit(Refit):
    """As `Refit`, for the little that a drive shows: the models are shrunk towards "nothing changes".

    Args:
        learnt: the controller; every action counts as if it had acted.
        episodes: the drives.
        mirrored: the same with left and right swapped, as true as they are.
        goal: whether z_ref is a goal, else the middle of what is met takes its place.
    """

    def __init__(
        self, learnt: LatentController, episodes: Sequence[Episode], mirrored: Sequence[Episode], goal: bool
    ) -> None:
        self._drives, self._mirrored = episodes, mirrored
        super().__init__(learnt, [*episodes, *mirrored], 0.0, goal)

    def model(self, C: Array) -> tuple[LinearModel, Array]:
        """Return the model of C psi around the reference, and its drift there."""
        found = self.shrunk(C)
        return found.model, found.drift

    def shrunk(self, C: Array) -> Shrunk:
        """Return the same, and how it was chosen."""
        return fit_shrunk(self._snapshots(C, self._drives), self._snapshots(C, self._mirrored))

    def _snapshots(self, C: Array, episodes: Sequence[Episode]) -> Snapshots:
        """Return drives as deviations of C psi and of the actions from the reference."""
        z = [(episode.features - self._psi_ref) @ C.T for episode in episodes]
        u = np.concatenate([episode.actions for episode in episodes]) - self._a_ref
        return Snapshots(np.concatenate([each[:-1] for each in z]), u, np.concatenate([each[1:] for each in z]))


def refit(policy: LatentPolicy, drives: Sequence[Drive], sizes: Sequence[int] = SIZES) -> LatentPolicy:
    """Return the regulator of a model of recorded drives that does what a policy does, with the region they span.

    Of the projections whose regulator does the same, the one that predicts best in cross-validation is taken.

    Args:
        policy: a latent one that drives from a lidar.
        drives: x as the policy sees it, and commands.
        sizes: latent dimensions to try.

    Raises:
        KoopmanError: the policy is of another task, the drives are too short, or no model has a regulator.
    """
    learnt = _unprojected(policy.controller)
    if not drives:
        raise KoopmanError("no drive to fit to")
    episodes = [_episode(learnt, policy, drive) for drive in drives]
    mirrored = [_episode(learnt, policy, _mirrored(policy, drive)) for drive in drives]
    found = OfflineRefit(learnt, episodes, mirrored, goal=bool(learnt.z_ref.any()))
    tried: list[tuple[Regulator, float, float]] = []
    for family, C in found.projections(sizes):
        regulator = found.regulator(family, C)
        if regulator is not None:
            shrunk = found.shrunk(C)
            tried.append((regulator, shrunk.crossed, shrunk.ridge))
    if not tried:
        raise KoopmanError("no regulator: the refitted model cannot be stabilised; record a livelier drive")
    same = [each for each in tried if each[0].mismatch <= _SAME_LAW]
    chosen, crossed, ridge = (
        min(same, key=lambda each: each[1]) if same else min(tried, key=lambda each: each[0].mismatch)
    )
    controller = chosen.controller
    region = region_of_episodes(controller.predict, *projected(controller.project, [*episodes, *mirrored]))
    figures = {
        "latent": len(controller.Q),
        "family": chosen.family,
        "mismatch": chosen.mismatch,
        "contraction": chosen.contraction,
        "ridge": ridge,
        "cross_validated_error_over_persistence": crossed,
        "spectral_radius": controller.spectral_radius,
        "dare_residual": controller.residual,
    }
    manifest = {**policy.manifest, **figures}
    return LatentPolicy(controller, _usual_step(drives), policy.wiring, manifest, region)


def _episode(learnt: LatentController, policy: LatentPolicy, drive: Drive) -> Episode:
    """Return a drive as an episode; nobody paid for it."""
    actions = controls_of(policy, drive.u)
    none: dict[str, Any] = {}
    return Episode(learnt.encoder(drive.x), actions, float("nan"), len(actions), 0.0, none)


def _mirrored(policy: LatentPolicy, drive: Drive) -> Drive:
    """Return a drive as it would have been had left and right been swapped."""
    order, sign = wiring_of(policy).observation.mirror
    return Drive(drive.x[:, order] * sign, drive.u * (1.0, -1.0), drive.dt)


def _unprojected(controller: LatentController) -> LatentController:
    """Return the same controller with its projection as the encoder's last layer."""
    if controller.projection is None:
        return controller
    weight = controller.projection.astype(np.float32)
    last = Dense(weight, np.zeros(len(weight), np.float32), False)
    encoder = replace(controller.encoder, layers=(*controller.encoder.layers, last))
    return replace(controller, encoder=encoder, projection=None)


def _usual_step(drives: Sequence[Drive]) -> float:
    return float(np.average([drive.dt for drive in drives], weights=[len(drive) for drive in drives]))
