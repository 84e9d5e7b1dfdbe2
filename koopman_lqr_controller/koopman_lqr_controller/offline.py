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
from koopman_lqr_controller.linear_loop import controls_of
from koopman_lqr_controller.region import region_of_episodes
from koopman_lqr_controller.regulators import Refit, Regulator
from koopman_lqr_controller.roll_outs import Lived
from koopman_lqr_controller.shrinkage import fit_shrunk

Array = NDArray[np.float64]

SIZES = (4, 8, 16, 1000)
"""Latent dimensions that are tried; those beyond the encoder's own stand for all of them."""
_SAME_LAW = 0.1
"""Mismatch up to which a regulator does what the policy does, see `Law.mismatch`."""


class OfflineRefit(Refit):
    """As `Refit`, for the little that a drive shows: the models are shrunk towards "nothing changes"."""

    def __init__(self, learnt: LatentController, lived: Sequence[Lived], goal: bool) -> None:
        super().__init__(learnt, lived, 0.0, goal)

    def model(self, C: Array) -> tuple[LinearModel, Array]:
        """Return the model of C psi around the reference, and its drift there."""
        found = fit_shrunk(self.snapshots(C))
        return found.model, found.drift

    def snapshots(self, C: Array) -> Snapshots:
        """Return what was lived through as deviations of C psi and of the actions from the reference."""
        z = [(episode.features - self._psi_ref) @ C.T for episode in self._lived]
        u = np.concatenate([episode.actions for episode in self._lived]) - self._a_ref
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
    lived = [_lived(learnt, policy, drive) for drive in drives]
    if not lived:
        raise KoopmanError("no drive to fit to")
    found = OfflineRefit(learnt, lived, goal=bool(learnt.z_ref.any()))
    tried: list[tuple[Regulator, float, float]] = []
    for family, C in found.projections(sizes):
        regulator = found.regulator(family, C)
        if regulator is not None:
            shrunk = fit_shrunk(found.snapshots(C))
            tried.append((regulator, shrunk.crossed, shrunk.ridge))
    if not tried:
        raise KoopmanError("no regulator: the refitted model cannot be stabilised; record a livelier drive")
    same = [each for each in tried if each[0].mismatch <= _SAME_LAW]
    chosen, crossed, ridge = (
        min(same, key=lambda each: each[1]) if same else min(tried, key=lambda each: each[0].mismatch)
    )
    controller = chosen.controller
    z = [controller.project(episode.features) for episode in lived]
    region = region_of_episodes(controller.predict, z, [episode.actions for episode in lived])
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


def _lived(learnt: LatentController, policy: LatentPolicy, drive: Drive) -> Lived:
    """Return a drive as an episode; nobody paid for it."""
    actions = controls_of(policy, drive.u)
    none: dict[str, Any] = {}
    return Lived(learnt.encoder(drive.x), actions, float("nan"), len(actions), 0.0, none)


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
