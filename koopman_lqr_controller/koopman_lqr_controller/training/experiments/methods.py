"""What is compared: thesis chapter 4, its ablations, and others under the same budget. Imports no torch."""

from __future__ import annotations

from dataclasses import dataclass

LEARNERS = ("koopman", "sac", "two_stage", "edmd")
"""What learns, see `runs`."""
Changes = tuple[tuple[str, int | float | str], ...]


@dataclass(frozen=True)
class Method:
    """A way of learning.

    Attributes:
        label: Name in tables and pictures.
        changes: Changes of the task's settings.
        learner: One of `LEARNERS`.
    """

    label: str
    changes: Changes = ()
    learner: str = "koopman"


METHODS = {
    "koopman": Method("task-oriented Koopman"),
    "network": Method("contrastive encoder, network policy (as CURL)", (("policy", "network"),)),
    "sac": Method("SAC (Stable-Baselines3)", learner="sac"),
    "reconstruction": Method("autoencoder, reconstruction", (("encoder_loss", "reconstruction"),)),
    "reconstruction_prediction": Method(
        "autoencoder, reconstruction and prediction", (("encoder_loss", "reconstruction_prediction"),)
    ),
    "two_stage": Method("two stages, learnt lifting, Q1", (), "two_stage"),
    "two_stage_q2": Method("two stages, learnt lifting, Q2", (("cost", "Q2"),), "two_stage"),
    "two_stage_q3": Method("two stages, learnt lifting, Q3", (("cost", "Q3"),), "two_stage"),
    "two_stage_q4": Method("two stages, learnt lifting, Q4", (("cost", "Q4"),), "two_stage"),
    "edmd": Method("two stages, EDMD with random features, Q1", (), "edmd"),
    "iterations_3": Method("M = 3", (("riccati_iterations", 3),)),
    "iterations_10": Method("M = 10", (("riccati_iterations", 10),)),
    "latent_4": Method("latent 4", (("latent", 4),)),
    "latent_6": Method("latent 6", (("latent", 6),)),
    "latent_30": Method("latent 30", (("latent", 30),)),
    "latent_100": Method("latent 100", (("latent", 100),)),
}
"""By name; the settings of "koopman" are M = 5 and latent 50."""
