"""The settings of consolidation, and the first seeds of its episodes."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

from koopman_lqr_controller.training.consolidation.distillation import DistillationSettings

REPORT_SEED = 5_000_000
"""First seed of the new episodes used to report returns."""
SEEDS = {"fit": 3_000_000, "choose": 4_000_000, "report": REPORT_SEED, "measure": 6_000_000}
"""First seeds of the episodes for training, for selection, and for reporting returns and errors."""
_FILE_NAMES = {"max_return_loss": "hopeless", "exploratory_latent": "scout"}
"""Former names of fields, used in the files of finished and unfinished runs."""


@dataclass(frozen=True)
class ConsolidationConfig:
    """Settings of consolidation.

    Attributes:
        episodes: Number of episodes per round; a fifth is held out to select by the model's error.
        noise: Maximum standard deviation of the noise added to u; the minimum is 0.
        rounds: Number of rounds: the first with the learnt policy, the others with a candidate, labelled by the learnt
            policy's actions.
        exploratory_latent: Latent dimension of that candidate.
        sizes: Latent dimensions tried in the end.
        max_return_loss: Fraction of the learnt return above which the loss of a candidate excludes retries with less
            weight on prediction.
        tolerance: Maximum fraction of the learnt return that may be lost, including one standard error, over all
            episodes and over the undisturbed ones.
        error: Maximum one-step error of the model relative to persistence; the aim is a third, and errors at selection
            are slightly optimistic.
        candidates: Number of episodes per candidate.
        disturbance: Standard deviation of the noise added to u in every other episode, which reveals marginally stable
            behaviour.
        prediction: Factors on the prediction weights, tried in order until the return is kept.
        report: Number of new episodes for the report, the same for the learnt and the consolidated policy.
        distillation: Training settings of the candidates.
        thorough: Training settings for the larger half of the sizes, used if no other candidate meets all requirements.
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
        """Return all fields under the names used in the files of runs."""
        return {_FILE_NAMES.get(name, name): value for name, value in asdict(self).items()}

    @classmethod
    def of(cls, episodes: int, report: int, **changes: Any) -> ConsolidationConfig:
        """Return a configuration with this many episodes per round, scaled accordingly, and for the report."""
        episodes = max(5, episodes)
        config = cls(episodes, candidates=episodes, report=report, **changes)
        share = min(1.0, (episodes / cls.episodes) ** 2)
        usual, thorough = (
            replace(each, updates=round(share * each.updates)) for each in (config.distillation, config.thorough)
        )
        return replace(config, distillation=usual, thorough=thorough)
