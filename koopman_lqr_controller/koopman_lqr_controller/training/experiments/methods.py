"""The compared methods: thesis chapter 4, its ablations, and others under the same budget. Imports no torch."""

from __future__ import annotations

from dataclasses import dataclass

LEARNERS = ("koopman", "sac", "two_stage", "edmd")
"""Names of learners, see `runs`."""
Changes = tuple[tuple[str, int | float | str], ...]


@dataclass(frozen=True)
class Method:
    """A learning method.

    Attributes:
        label: Name in tables and figures.
        changes: Changes to the task's settings.
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
    **{
        f"two_stage_q{number}": Method(f"two stages, learnt lifting, Q{number}", (("cost", f"Q{number}"),), "two_stage")
        for number in (2, 3, 4)
    },
    "edmd": Method("two stages, EDMD with random features, Q1", (), "edmd"),
    **{f"iterations_{number}": Method(f"M = {number}", (("riccati_iterations", number),)) for number in (3, 10)},
    **{f"latent_{number}": Method(f"latent {number}", (("latent", number),)) for number in (4, 6, 30, 100)},
}
"""Methods by name; the settings of "koopman" are M = 5 and latent 50."""
