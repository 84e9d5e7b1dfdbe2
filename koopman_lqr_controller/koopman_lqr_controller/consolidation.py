"""After learning: a controller that is the LQR of its own model (beyond the thesis).

What learning leaves is a gain after a few Riccati iterations, on a model that serves the gain more than prediction: the
closed loop of that model is often not even stable. Consolidation keeps the encoder and what the policy does, and makes
the rest true. It runs noisy episodes and refits A and B to them by least squares. It finds diagonal Q and R
whose infinite-horizon gain does the same as the policy (inverse LQR), in units of actions: what is deployed is that
law, cut off at -1 and 1, so that the loop of the proof is the loop that runs. It takes as few latent dimensions as keep
the return and predict. What comes out proves itself: its gain is computed from A, B, Q, R whenever it is loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.latent_controller import LatentController
from koopman_lqr_controller.prediction import horizon_errors
from koopman_lqr_controller.region import Region, region_of_episodes
from koopman_lqr_controller.regulators import LARGEST_RESIDUAL, Refit, Regulator
from koopman_lqr_controller.roll_outs import (
    Environment,
    Episode,
    evaluate,
    interaction,
    mean_return,
    noisy_roll_outs,
    outcomes,
    projected,
    saturated,
)

HORIZON = 10
"""Steps that the model's error is told for."""
REPORT_SEED = 5_000_000
"""Where the seeds of fresh episodes begin that returns are reported on."""
_SEEDS = {"fit": 3_000_000, "choose": 4_000_000, "report": REPORT_SEED, "measure": 6_000_000}
"""Where the seeds of episodes begin: of those to learn from, to choose by, and to report returns and errors on."""


@dataclass(frozen=True)
class Plan:
    """How is consolidated.

    Attributes:
        episodes: of each round; a fifth is kept from the fit, to choose by the model's error.
        noise: largest standard deviation added to u, the least is none.
        rounds: the first with the learnt policy, the others with the best candidate so far, which the learnt policy
            tells what it would have done.
        ridge: of the refit, relative to each regressor's variance.
        sizes: latent dimensions that are tried; those beyond the policy's own stand for all of them.
        tolerance: part of the learnt return that may be lost.
        error: one-step error over persistence that the model may have.
        candidates: episodes of each candidate.
        report: fresh episodes, the same for the learnt policy and for what comes of it.
    """

    episodes: int = 30
    noise: float = 0.5
    rounds: int = 2
    ridge: float = 1e-4
    sizes: tuple[int, ...] = (4, 6, 8, 12, 16, 24, 1000)
    tolerance: float = 0.01
    error: float = 1 / 3
    candidates: int = 10
    report: int = 20

    @classmethod
    def of(cls, episodes: int, report: int, **changes: Any) -> Plan:
        """Return a plan of so many episodes in a round, candidates in proportion to them, and so many fresh ones."""
        return cls(episodes=max(5, episodes), candidates=max(2, episodes // 3), report=report, **changes)


@dataclass(frozen=True)
class Consolidated:
    """What came of it.

    Attributes:
        controller: with the infinite horizon.
        region: of the noisy episodes that its model was fitted to and chosen by.
        figures: learnt and consolidated returns, and what control theory says, as JSON.
    """

    controller: LatentController
    region: Region
    figures: dict[str, Any]


@dataclass(frozen=True)
class _Candidate:
    regulator: Regulator
    score: float
    error: float

    @property
    def controller(self) -> LatentController:
        return self.regulator.controller

    def meets(self, learnt_score: float, plan: Plan) -> dict[str, bool]:
        least = learnt_score - plan.tolerance * abs(learnt_score)
        return {"return": self.score >= least, "error": self.error <= plan.error}

    def row(self) -> dict[str, Any]:
        found = self.regulator
        return {
            "latent": len(self.controller.Q),
            "family": found.family,
            "return": self.score,
            "mismatch": found.mismatch,
            "contraction": found.contraction,
            "error_over_persistence": self.error,
        }


def consolidate(
    learnt: LatentController,
    environment: Environment,
    plan: Plan | None = None,
    goal: bool = True,
    seed: int = 0,
    tick: Callable[[str], None] = lambda _: None,
    reported: Sequence[Episode] | None = None,
) -> Consolidated:
    """Return the regulator that does what a learnt controller does.

    Args:
        learnt: the controller.
        environment: where it was learnt.
        plan: how.
        goal: whether z_ref is a goal; else the middle of what the policy goes through takes its place.
        seed: of all episodes.
        tick: told what is done: before each part, and after each candidate.
        reported: fresh episodes of the learnt controller from `REPORT_SEED` on, where there are some already; else it
            is evaluated.

    Raises:
        KoopmanError: no candidate has a regulator, or the controller is consolidated already.
    """
    if learnt.horizon is None:
        raise KoopmanError("this policy is the regulator of its own model already: give the one that `learn` made")
    plan = plan or Plan()
    search = _Search(learnt, environment, plan, seed, tick)
    acting = learnt
    for index in range(plan.rounds):
        search.run(acting, index)
        refit = Refit(learnt, search.seen, plan.ridge, goal)
        search.try_out(refit)
        acting = max(search.tried, key=lambda candidate: candidate.score).controller
    chosen = search.choose()
    found = chosen.regulator
    measured = search.measure(chosen.controller)
    before = search.report(learnt) if reported is None else reported
    after = search.report(chosen.controller)
    figures = {
        "returns": [episode.total for episode in after],
        "outcomes": outcomes(after),
        "meets": chosen.meets(search.learnt_score, plan),
        "latent": len(chosen.controller.Q),
        "family": found.family,
        "mismatch": found.mismatch,
        "contraction": found.contraction,
        "saturated": saturated(after),
        **proof(chosen.controller, measured),
        "unreduced_horizon_errors": _errors(refit, measured),
        "learnt": {
            "returns": [episode.total for episode in before],
            "outcomes": outcomes(before),
            "saturated": saturated(before),
            "spectral_radius": learnt.spectral_radius,
            "error_over_persistence": _errors(learnt, measured)[0],
        },
        "interaction": interaction(search.all_episodes),
        "candidates": [each.row() for each in search.tried],
    }
    return Consolidated(chosen.controller, search.region(chosen.controller), figures)


def proof(controller: LatentController, episodes: Sequence[Episode]) -> dict[str, Any]:
    """Return what shows that a controller is the LQR of its own model, and that the model predicts.

    Raises:
        KoopmanError: it is not.
    """
    if not (controller.spectral_radius < 1.0 and controller.residual < LARGEST_RESIDUAL):
        found = f"spectral radius {controller.spectral_radius:.4f}, Riccati residual {controller.residual:.1e}"
        raise KoopmanError(f"{found}: not the regulator of its own model")
    errors = _errors(controller, episodes)
    return {
        "spectral_radius": controller.spectral_radius,
        "dare_residual": controller.residual,
        "error_over_persistence": errors[0],
        "horizon_errors": errors,
    }


class _Search:
    """The episodes so far, and what was tried out."""

    def __init__(
        self,
        learnt: LatentController,
        environment: Environment,
        plan: Plan,
        seed: int,
        tick: Callable[[str], None],
    ) -> None:
        self._learnt, self._environment, self._plan, self._tick = learnt, environment, plan, tick
        self._first = {name: base + 10_000 * seed for name, base in _SEEDS.items()}
        self._episodes: list[Episode] = []
        self.tried: list[_Candidate] = []
        self.all_episodes: list[Episode] = []
        tick("the learnt policy")
        self.learnt_score = self._score(learnt)

    @property
    def seen(self) -> list[Episode]:
        """What models are fitted to; every fifth episode is kept from them."""
        return [episode for number, episode in enumerate(self._episodes) if number % 5]

    def run(self, acting: LatentController, index: int) -> None:
        """Run the episodes of a round."""
        self._tick(f"{self._plan.episodes} episodes")
        noises = np.linspace(0.0, self._plan.noise, self._plan.episodes).tolist()
        fresh = noisy_roll_outs(acting, self._environment, noises, self._first["fit"] + 1000 * index)
        self._episodes += fresh
        self.all_episodes += fresh

    def try_out(self, refit: Refit) -> None:
        """Try one regulator after the other, until one keeps the return and predicts.

        Raises:
            KoopmanError: there is none at all.
        """
        for family, C in refit.projections(self._plan.sizes):
            found = refit.regulator(family, C)
            if found is None:
                continue
            candidate = _Candidate(found, self._score(found.controller), self._error(found.controller))
            self.tried.append(candidate)
            self._tick(f"{len(C)} dimensions: {candidate.score:.4g} of {self.learnt_score:.4g}")
            if all(candidate.meets(self.learnt_score, self._plan).values()):
                return
        if not self.tried:
            raise KoopmanError("no regulator: the refitted model cannot be stabilised; learn longer")

    def choose(self) -> _Candidate:
        """Return the smallest that keeps the return and predicts.

        Where none does both, the best predictor of those that keep the return; where none does that, what keeps it
        best. All are held against the same episodes.
        """
        tried = [_Candidate(each.regulator, each.score, self._error(each.controller)) for each in self.tried]
        self.tried = tried

        def rank(each: _Candidate) -> tuple[float, ...]:
            meets = each.meets(self.learnt_score, self._plan)
            if all(meets.values()):
                return (2.0, -len(each.controller.Q), each.score)
            return (1.0, -each.error, each.score) if meets["return"] else (0.0, each.score, -each.error)

        return max(tried, key=rank)

    def measure(self, chosen: LatentController) -> list[Episode]:
        """Return fresh noisy episodes of the learnt and the chosen controller, that nothing was chosen by."""
        self._tick("the model's error")
        noises = np.linspace(0.0, self._plan.noise, max(2, self._plan.episodes // 5)).tolist()
        first = self._first["measure"]
        return [
            episode
            for index, each in enumerate((self._learnt, chosen))
            for episode in noisy_roll_outs(each, self._environment, noises, first + 1000 * index)
        ]

    def region(self, controller: LatentController) -> Region:
        """Return where a controller may be trusted: what the noisy episodes went through."""
        return region_of_episodes(controller.predict, *projected(controller.project, self._episodes))

    def report(self, controller: LatentController) -> list[Episode]:
        """Return fresh episodes without noise."""
        self._tick(f"{self._plan.report} fresh episodes")
        return evaluate(controller, self._environment, self._plan.report, self._first["report"])

    def _score(self, controller: LatentController) -> float:
        episodes = evaluate(controller, self._environment, self._plan.candidates, self._first["choose"])
        self.all_episodes += episodes
        return mean_return(episodes)

    def _error(self, controller: LatentController) -> float:
        return _errors(controller, self._episodes[::5])[0]


def _errors(model: LatentController | Refit, episodes: Sequence[Episode]) -> list[float]:
    """Return the errors over persistence after 1, 2, ... steps, in what the model predicts."""
    return horizon_errors(model.predict, *projected(model.project, episodes), HORIZON)
