"""After learning: a controller that is the LQR of its own model (beyond the thesis).

What learning leaves is a gain after a few Riccati iterations, on a model that serves the gain more than prediction: the
closed loop of that model is often not even stable. Consolidation keeps what the policy does and makes the rest true. It
runs noisy episodes and finds coordinates, a model, Q and R in which the infinite-horizon LQR does the same and the
model predicts (`distillation`). First it does so for an exploratory candidate, whose episodes hold new mistakes. It
then takes as few latent dimensions as keep the return and predict. The law is in units of actions, cut off at -1 and 1,
so that the loop of the proof is the loop that runs, and it proves itself: its gain is computed whenever it is loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.data.roll_outs import (
    Environment,
    Episode,
    Policy,
    count_interaction,
    evaluate,
    noisy_roll_outs,
    outcomes,
    projected,
    roll_out,
    saturated,
)
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.identification.regulators import LARGEST_RESIDUAL
from koopman_lqr_controller.models.prediction import HORIZON, Array, horizon_errors, law_error
from koopman_lqr_controller.safety.latent_distribution import LatentDistribution, fit_distribution_to_episodes
from koopman_lqr_controller.training.consolidation.distillation import DistillationSettings, DistilledPolicy, distil

REPORT_SEED = 5_000_000
"""Where the seeds of fresh episodes begin that returns are reported on."""
_SEEDS = {"fit": 3_000_000, "choose": 4_000_000, "report": REPORT_SEED, "measure": 6_000_000}
"""Where the seeds of episodes begin: of those to learn from, to choose by, and to report returns and errors on."""
_FILE_NAMES = {"max_return_loss": "hopeless", "exploratory_latent": "scout"}
"""Older names of fields, which the files of finished and unfinished runs hold."""


@dataclass(frozen=True)
class ConsolidationConfig:
    """How is consolidated.

    Attributes:
        episodes: of each round; a fifth is kept from the fit, to choose by the model's error.
        noise: largest standard deviation added to u, the least is none.
        rounds: the first with the learnt policy, the others with a candidate, which the learnt policy tells what it
            would have done.
        exploratory_latent: Latent dimensions of that candidate.
        sizes: latent dimensions that are tried in the end.
        max_return_loss: Part of the learnt return; a candidate that loses more is not tried with less weight on
            prediction.
        tolerance: part of the learnt return that may be lost, with the standard error that the loss is known to, in
            all episodes and in those that are not disturbed.
        error: one-step error over persistence that the model may have; a third is wanted, and what is chosen by is a
            little better than what is fresh.
        candidates: episodes of each candidate.
        disturbance: standard deviation added to u in every other one of them: what walks on an edge falls.
        prediction: what the weights of prediction are multiplied by, one after the other until the return is kept.
        report: fresh episodes, the same for the learnt policy and for what comes of it.
        distillation: how candidates are trained.
        thorough: how those of the larger half of the sizes are, where none of the others does all that is wanted.
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


@dataclass(frozen=True)
class ConsolidationResult:
    """What came of it.

    Attributes:
        controller: with the infinite horizon.
        distribution: of the noisy episodes that its model was fitted to and chosen by.
        figures: learnt and consolidated returns, and what control theory says, as JSON.
    """

    controller: LatentController
    distribution: LatentDistribution
    figures: dict[str, Any]


@dataclass(frozen=True)
class _Candidate:
    policy: DistilledPolicy
    settings: DistillationSettings
    share: float
    score: float
    lost: float
    error: float

    def meets(self, learnt_score: float, config: ConsolidationConfig) -> dict[str, bool]:
        return {"return": self.lost <= config.tolerance * abs(learnt_score), "error": self.error <= config.error}

    def row(self) -> dict[str, Any]:
        return {
            "latent": len(self.policy.controller.Q),
            "hidden": self.settings.hidden,
            "updates": self.settings.updates,
            "prediction": self.share,
            "return": self.score,
            "error_over_persistence": self.error,
        }


def consolidate(
    learnt: LatentController,
    environment: Environment,
    config: ConsolidationConfig | None = None,
    goal: bool = True,
    seed: int = 0,
    on_progress: Callable[[str], None] = lambda _: None,
    reported: Sequence[Episode] | None = None,
) -> ConsolidationResult:
    """Return the regulator that does what a learnt controller does.

    Args:
        learnt: the controller.
        environment: where it was learnt.
        config: how.
        goal: whether z_ref is a goal; else the middle of what the policy goes through takes its place.
        seed: of all episodes.
        on_progress: told what is done: before each part, and after each candidate.
        reported: fresh episodes of the learnt controller from `REPORT_SEED` on, where there are some already; else it
            is evaluated.

    Raises:
        KoopmanError: no candidate has a regulator, or the controller is consolidated already.
    """
    if learnt.horizon is None:
        raise KoopmanError("this policy is the regulator of its own model already: give the one that `learn` made")
    config = config or ConsolidationConfig()
    search = _Search(learnt, environment, config, goal, seed, on_progress)
    acting: Policy = learnt
    for index in range(config.rounds):
        search.run(acting, index)
        if index < config.rounds - 1:
            acting = search.exploratory_candidate() or acting
    chosen = search.choose()
    controller = chosen.policy.controller
    measured = search.measure(chosen.policy)
    before = search.report(learnt) if reported is None else reported
    after = search.report(controller)
    figures = {
        "returns": [episode.total for episode in after],
        "outcomes": outcomes(after),
        "meets": chosen.meets(search.learnt_score, config),
        "latent": len(controller.Q),
        "saturated": saturated(after),
        **proof(chosen.policy, measured),
        "learnt": {
            "returns": [episode.total for episode in before],
            "outcomes": outcomes(before),
            "saturated": saturated(before),
            "spectral_radius": learnt.spectral_radius,
            **_errors(learnt, *projected(learnt.project, measured), 1),
        },
        "interaction": count_interaction(search.all_episodes),
        "candidates": [each.row() for each in search.tried],
    }
    return ConsolidationResult(controller, search.distribution(chosen.policy), figures)


def proof(policy: DistilledPolicy, episodes: Sequence[Episode]) -> dict[str, Any]:
    """Return what shows that a policy is the LQR of its own model, and that the model predicts.

    Args:
        policy: as it was found.
        episodes: with the features of the learnt policy.

    Raises:
        KoopmanError: it is not.
    """
    controller = policy.controller
    _check_regulator(controller)
    return {
        "spectral_radius": controller.spectral_radius,
        "dare_residual": controller.residual,
        **_errors(controller, *projected(policy.project, episodes), HORIZON),
    }


def _errors(controller: LatentController, z: Sequence[Array], actions: Sequence[Array], steps: int) -> dict[str, Any]:
    """Return how far the model is off over persistence: in z, after so many steps where more than one, and in K z."""
    errors = horizon_errors(controller.predict, z, actions, steps)
    return {
        "error_over_persistence": errors[0],
        **({"horizon_errors": errors} if steps > 1 else {}),
        "law_error": law_error(controller.predict, controller.K, z, actions),
    }


def _check_regulator(controller: LatentController) -> None:
    if not (controller.spectral_radius < 1.0 and controller.residual < LARGEST_RESIDUAL):
        found = f"spectral radius {controller.spectral_radius:.4f}, Riccati residual {controller.residual:.1e}"
        raise KoopmanError(f"{found}: not the regulator of its own model")


class _Search:
    """The episodes so far, and what was tried out."""

    def __init__(
        self,
        learnt: LatentController,
        environment: Environment,
        config: ConsolidationConfig,
        goal: bool,
        seed: int,
        on_progress: Callable[[str], None],
    ) -> None:
        self._learnt, self._environment, self._config, self._report_progress = learnt, environment, config, on_progress
        self._goal, self._seed = goal, seed
        self._first = {name: base + 10_000 * seed for name, base in _SEEDS.items()}
        self._episodes: list[Episode] = []
        self.tried: list[_Candidate] = []
        self.all_episodes: list[Episode] = []
        self._problem = "no size to try"
        on_progress("the learnt policy")
        self._learnt_returns = self._returns(learnt)
        self.learnt_score = float(self._learnt_returns.mean())

    @property
    def seen(self) -> list[Episode]:
        """What models are fitted to; every fifth episode is kept from them."""
        return [episode for number, episode in enumerate(self._episodes) if number % 5]

    def run(self, acting: Policy, index: int) -> None:
        """Run the episodes of a round."""
        self._report_progress(f"{self._config.episodes} episodes")
        noises = np.linspace(0.0, self._config.noise, self._config.episodes).tolist()
        fresh = noisy_roll_outs(acting, self._environment, noises, self._first["fit"] + 1000 * index)
        self._episodes += fresh
        self.all_episodes += fresh

    def exploratory_candidate(self) -> Policy | None:
        """Return a candidate that makes the mistakes that the next round is to learn from, None where there is none."""
        found = self._try(self._config.exploratory_latent, self._config.distillation, self._config.prediction[0])
        return found[0].policy if found else None

    def choose(self) -> _Candidate:
        """Return the smallest candidate that keeps the return and predicts.

        More and more dimensions are tried, then more thoroughly. Where none does both, return comes first: it is the
        best predictor of those that keep it; where none does that, what keeps it best.

        Raises:
            KoopmanError: none of them has a regulator.
        """
        config, tried = self._config, list[_Candidate]()
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

        def rank(each: _Candidate) -> tuple[float, ...]:
            return (1.0, -each.error, each.score) if self._meets(each)["return"] else (0.0, -each.lost, -each.error)

        return max(tried, key=rank)

    def _try_size(self, latent: int, settings: DistillationSettings) -> list[_Candidate]:
        """Return what was tried, that which may do last: less and less prediction may save the return."""
        tried: list[_Candidate] = []
        for share in self._config.prediction:
            for candidate in self._try(latent, settings, share):
                tried.append(candidate)
                meets = self._meets(candidate)
                max_return_loss = candidate.lost > self._config.max_return_loss * abs(self.learnt_score)
                if meets["return"] or not meets["error"] or max_return_loss:
                    return tried  # done, or more dimensions are wanted, not less prediction
        return tried

    def _meets(self, candidate: _Candidate) -> dict[str, bool]:
        return candidate.meets(self.learnt_score, self._config)

    def _try(self, latent: int, settings: DistillationSettings, share: float) -> list[_Candidate]:
        """Return a candidate, none where it has no regulator: another may have one."""
        try:
            candidate = self._candidate(latent, settings, share)
        except KoopmanError as error:
            self._problem = str(error)
            return []
        self.tried.append(candidate)
        self._report_progress(f"{latent} dimensions: {candidate.score:.4g} of {self.learnt_score:.4g}")
        return [candidate]

    def _candidate(self, latent: int, settings: DistillationSettings, share: float) -> _Candidate:
        found = distil(self._learnt, self.seen, latent, self._goal, settings.with_prediction(share), self._seed)
        _check_regulator(found.controller)
        returns = self._returns(found)
        losses = self._learnt_returns - returns
        lost = max(_surely_lost(losses), _surely_lost(losses[::2]))
        return _Candidate(found, settings, share, float(returns.mean()), lost, self._error(found))

    def measure(self, chosen: DistilledPolicy) -> list[Episode]:
        """Return fresh noisy episodes of the learnt and the chosen policy, that nothing was chosen by."""
        self._report_progress("the model's error")
        noises = np.linspace(0.0, self._config.noise, max(2, self._config.episodes // 2)).tolist()
        first = self._first["measure"]
        policies: tuple[Policy, ...] = (self._learnt, chosen)
        return [
            episode
            for index, each in enumerate(policies)
            for episode in noisy_roll_outs(each, self._environment, noises, first + 1000 * index)
        ]

    def distribution(self, chosen: DistilledPolicy) -> LatentDistribution:
        """Return where a policy may be trusted: what the noisy episodes went through."""
        return fit_distribution_to_episodes(chosen.controller.predict, *projected(chosen.project, self._episodes))

    def report(self, controller: LatentController) -> list[Episode]:
        """Return fresh episodes without noise."""
        self._report_progress(f"{self._config.report} fresh episodes")
        return evaluate(controller, self._environment, self._config.report, self._first["report"])

    def _returns(self, policy: Policy) -> Array:
        """Return those of the episodes (N,) that candidates are chosen by, every other one disturbed.

        The episodes are the same for all of them.
        """
        first = self._first["choose"]
        episodes = [
            roll_out(policy, self._environment, first + index, index % 2 * self._config.disturbance)
            for index in range(self._config.candidates)
        ]
        self.all_episodes += episodes
        return np.array([episode.total for episode in episodes])

    def _error(self, policy: DistilledPolicy) -> float:
        return horizon_errors(policy.controller.predict, *projected(policy.project, self._episodes[::5]), 1)[0]


def _surely_lost(losses: Array) -> float:
    """Return the mean of losses (N,) and one standard error: what fell once in some episodes may fall more often."""
    return float(losses.mean() + losses.std(ddof=min(1, len(losses) - 1)) / np.sqrt(len(losses)))
