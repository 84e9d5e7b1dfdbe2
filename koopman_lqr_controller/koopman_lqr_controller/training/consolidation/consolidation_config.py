"""The settings of consolidation, and where the seeds of its episodes begin."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

from koopman_lqr_controller.training.consolidation.distillation import DistillationSettings

REPORT_SEED = 5_000_000
"""First seed of the fresh episodes that returns are reported on."""
SEEDS = {"fit": 3_000_000, "choose": 4_000_000, "report": REPORT_SEED, "measure": 6_000_000}
"""First seeds of the episodes to learn from, to choose by, and to report returns and errors on."""
_FILE_NAMES = {"max_return_loss": "hopeless", "exploratory_latent": "scout"}
"""Older names of fields, which the files of finished and unfinished runs hold."""


@dataclass(frozen=True)
class ConsolidationConfig:
    """Settings of consolidation.

    Attributes:
        episodes: Number of episodes of each round; a fifth is kept from the fit, to choose by the model's error.
        noise: Largest standard deviation added to u, the least is none.
        rounds: The first with the learnt policy, the others with a candidate, which the learnt policy tells what it
            would have done.
        exploratory_latent: Latent dimensions of that candidate.
        sizes: Latent dimensions that are tried in the end.
        max_return_loss: Part of the learnt return; a candidate that loses more is not tried with less weight on
            prediction.
        tolerance: Part of the learnt return that may be lost, with the standard error that the loss is known to, in all
            episodes and in those that are not disturbed.
        error: one-step error over persistence that the model may have; a third is wanted, and what is chosen by is a
            little better than what is fresh.
        candidates: Episodes of each candidate.
        disturbance: Standard deviation added to u in every other one of them: what walks on an edge falls.
        prediction: Factors on the weights of prediction, tried one after the other until the return is kept.
        report: Fresh episodes, the same for the learnt policy and for what comes of it.
        distillation: Settings of the candidates' training.
        thorough: Settings for the larger half of the sizes, where no other candidate does all that is wanted.
    """

    episodes: int = 30
    noise: float = 0.5
    rounds: int = 3
    exploratory_latent: int = 12
    sizes: tuple[int, ...] = (4, 6, 8, 12, 16, 24)
    max_return_loss: float = 0.1
    tolerance: float = 0.02
    error: float = 0.3
    prediction: tuple[float, ...] = (1.0, 0.3, 0.1)
    candidates: int = 30
    disturbance: float = 0.1
    report: int = 20
    distillation: DistillationSettings = field(default_factory=DistillationSettings)
    thorough: DistillationSettings = field(default_factory=lambda: DistillationSettings(hidden=512, updates=8000))

    def as_json(self) -> dict[str, Any]:
        """Return all fields under the names that the files of runs hold."""
        return {_FILE_NAMES.get(name, name): value for name, value in asdict(self).items()}

    @classmethod
    def of(cls, episodes: int, report: int, **changes: Any) -> ConsolidationConfig:
        """Return a plan of so many episodes in a round, all else in proportion to them, and so many fresh ones."""
        episodes = max(5, episodes)
        config = cls(episodes, candidates=episodes, report=report, **changes)
        share = min(1.0, (episodes / cls.episodes) ** 2)
        usual, thorough = (
            replace(each, updates=round(share * each.updates)) for each in (config.distillation, config.thorough)
        )
        return replace(config, distillation=usual, thorough=thorough)
