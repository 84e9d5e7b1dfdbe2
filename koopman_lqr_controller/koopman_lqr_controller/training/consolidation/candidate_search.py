"""Search for the smallest regulator that keeps a learnt policy's return and predicts well."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ctrl_rl_core import DrivenRobot
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.data.roll_outs import (
    Episode,
    Policy,
    evaluate,
    noisy_roll_outs,
    projected,
    roll_out,
)
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.identification.regulators import LARGEST_RESIDUAL
from koopman_lqr_controller.models.prediction import horizon_errors
from koopman_lqr_controller.safety.guards import LatentDistribution, fit_distribution_to_episodes
from koopman_lqr_controller.training.consolidation.consolidation_config import SEEDS, ConsolidationConfig
from koopman_lqr_controller.training.consolidation.distillation import DistillationSettings, DistilledPolicy, distil


@dataclass(frozen=True)
class Candidate:
    """A candidate regulator.

    Attributes:
        policy: Regulator in its own coordinates.
        settings: Training settings.
        share: Factor on the prediction weights.
        score: Mean return in the selection episodes.
        lost: Upper estimate of the return lost relative to the learnt policy: mean plus one standard error.
        error: One-step error of the model relative to persistence.
    """

    policy: DistilledPolicy
    settings: DistillationSettings
    share: float
    score: float
    lost: float
    error: float

    def meets(self, learnt_score: float, config: ConsolidationConfig) -> dict[str, bool]:
        """Return whether return and error meet the limits.

        Args:
            learnt_score: Mean return of the learnt policy in the same episodes.
            config: Limits of lost return and of error.
        """
        return {"return": self.lost <= config.tolerance * abs(learnt_score), "error": self.error <= config.error}

    def row(self) -> dict[str, Any]:
        """Return settings and metrics as JSON."""
        return {
            "latent": len(self.policy.controller.Q),
            "hidden": self.settings.hidden,
            "updates": self.settings.updates,
            "prediction": self.share,
            "return": self.score,
            "error_over_persistence": self.error,
        }


def check_regulator(controller: LatentController) -> None:
    """Raise if a controller is not the LQR of its own model.

    Raises:
        KoopmanError: The closed loop is unstable, or the Riccati residual is too large.
    """
    if not (controller.spectral_radius < 1.0 and controller.residual < LARGEST_RESIDUAL):
        found = f"spectral radius {controller.spectral_radius:.4f}, Riccati residual {controller.residual:.1e}"
        raise KoopmanError(f"{found}: not the regulator of its own model")


class CandidateSearch:
    """Episodes and candidates of a search.

    Attributes:
        learnt: Learnt controller, with a finite horizon.
        config: Settings of the search.
        learnt_score: Mean return of the learnt controller in the selection episodes.
        tried: Candidates so far.
        all_episodes: Episodes so far, including evaluations.
    """

    def __init__(
        self,
        learnt: LatentController,
        environment: DrivenRobot[Any],
        config: ConsolidationConfig,
        goal: bool,
        seed: int,
        on_progress: Callable[[str], None],
    ) -> None:
        self.learnt, self._environment, self.config, self._report_progress = learnt, environment, config, on_progress
        self._goal, self._seed = goal, seed
        self._first = {name: base + 10_000 * seed for name, base in SEEDS.items()}
        self._episodes: list[Episode] = []
        self.tried: list[Candidate] = []
        self.all_episodes: list[Episode] = []
        self._problem = "no size to try"
        on_progress("the learnt policy")
        self._learnt_returns = self._returns(learnt)
        self.learnt_score = float(self._learnt_returns.mean())

    @property
    def seen(self) -> list[Episode]:
        """Episodes used to fit models; every fifth one is held out."""
        return [episode for number, episode in enumerate(self._episodes) if number % 5]

    def run(self, acting: Policy, index: int) -> None:
        """Run the episodes of a round."""
        self._report_progress(f"{self.config.episodes} episodes")
        noises = np.linspace(0.0, self.config.noise, self.config.episodes).tolist()
        fresh = noisy_roll_outs(acting, self._environment, noises, self._first["fit"] + 1000 * index)
        self._episodes += fresh
        self.all_episodes += fresh

    def exploratory_candidate(self) -> Policy | None:
        """Return a candidate whose mistakes the next round learns from, or None."""
        found = self._try(self.config.exploratory_latent, self.config.distillation, self.config.prediction[0])
        return found[0].policy if found else None

    def choose(self) -> Candidate:
        """Return the smallest candidate that keeps the return and predicts well.

        Increasing dimensions are tried, then more thorough training. If no candidate satisfies both, the return takes
        precedence: the best predictor among those that keep it, or else the one with the smallest loss.

        Raises:
            KoopmanError: No candidate has a regulator.
        """
        config, tried = self.config, list[Candidate]()
        for settings, sizes in (
            (config.distillation, config.sizes),
            (config.thorough, config.sizes[len(config.sizes) // 2 :]),
        ):
            for latent in sizes:
                tried += self._try_size(latent, settings)
                if tried and all(self._meets(tried[-1]).values()):
                    return tried[-1]
        for share in config.prediction[1:]:
            if not any(self._meets(each)["return"] for each in tried):
                tried += self._try(config.sizes[-1], config.thorough, share)
        if not tried:
            raise KoopmanError(f"no regulator: {self._problem}; learn longer")

        def rank(each: Candidate) -> tuple[float, ...]:
            return (1.0, -each.error, each.score) if self._meets(each)["return"] else (0.0, -each.lost, -each.error)

        return max(tried, key=rank)

    def _try_size(self, latent: int, settings: DistillationSettings) -> list[Candidate]:
        """Return the candidates of one size, acceptable one last, with decreasing weight on prediction."""
        tried: list[Candidate] = []
        for share in self.config.prediction:
            for candidate in self._try(latent, settings, share):
                tried.append(candidate)
                meets = self._meets(candidate)
                max_return_loss = candidate.lost > self.config.max_return_loss * abs(self.learnt_score)
                if meets["return"] or not meets["error"] or max_return_loss:
                    return tried  # done, or more dimensions are needed rather than less prediction
        return tried

    def _meets(self, candidate: Candidate) -> dict[str, bool]:
        return candidate.meets(self.learnt_score, self.config)

    def _try(self, latent: int, settings: DistillationSettings, share: float) -> list[Candidate]:
        """Return a candidate, or None if it has no regulator."""
        try:
            candidate = self._candidate(latent, settings, share)
        except KoopmanError as error:
            self._problem = str(error)
            return []
        self.tried.append(candidate)
        self._report_progress(f"{latent} dimensions: {candidate.score:.4g} of {self.learnt_score:.4g}")
        return [candidate]

    def _candidate(self, latent: int, settings: DistillationSettings, share: float) -> Candidate:
        found = distil(self.learnt, self.seen, latent, self._goal, settings.with_prediction(share), self._seed)
        check_regulator(found.controller)
        returns = self._returns(found)
        losses = self._learnt_returns - returns
        lost = max(loss_bound(losses), loss_bound(losses[::2]))
        return Candidate(found, settings, share, float(returns.mean()), lost, self._error(found))

    def measure(self, chosen: DistilledPolicy) -> list[Episode]:
        """Run new noisy episodes of the learnt and the chosen policy, not used for selection."""
        self._report_progress("the model's error")
        noises = np.linspace(0.0, self.config.noise, max(2, self.config.episodes // 2)).tolist()
        first = self._first["measure"]
        policies: tuple[Policy, ...] = (self.learnt, chosen)
        return [
            episode
            for index, each in enumerate(policies)
            for episode in noisy_roll_outs(each, self._environment, noises, first + 1000 * index)
        ]

    def distribution(self, chosen: DistilledPolicy) -> LatentDistribution:
        """Return the training distribution for a policy, from the noisy episodes."""
        return fit_distribution_to_episodes(chosen.controller.predict, *projected(chosen.project, self._episodes))

    def report(self, controller: LatentController) -> list[Episode]:
        """Run new episodes without noise."""
        self._report_progress(f"{self.config.report} fresh episodes")
        return evaluate(controller, self._environment, self.config.report, self._first["report"])

    def _returns(self, policy: Policy) -> Array:
        """Return the returns in the selection episodes (N,), with a disturbance in every other one.

        The episodes are the same for all candidates.
        """
        first = self._first["choose"]
        episodes = [
            roll_out(policy, self._environment, first + index, index % 2 * self.config.disturbance)
            for index in range(self.config.candidates)
        ]
        self.all_episodes += episodes
        return np.array([episode.total for episode in episodes])

    def _error(self, policy: DistilledPolicy) -> float:
        return horizon_errors(policy.controller.predict, *projected(policy.project, self._episodes[::5]), 1)[0]


def loss_bound(losses: Array) -> float:
    """Return the mean of losses (N,) plus one standard error, since rare failures may be underrepresented."""
    return float(losses.mean() + losses.std(ddof=min(1, len(losses) - 1)) / np.sqrt(len(losses)))
