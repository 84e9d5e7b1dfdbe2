"""After learning: a controller that is the LQR of its own model (beyond the thesis).

What learning leaves is a gain after a few Riccati iterations, on a model that serves the gain more than prediction: the
closed loop of that model is often not even stable. Consolidation keeps the encoder and what the policy does, and makes
the rest true. It lives through noisy episodes and refits A and B to them by least squares. It finds diagonal Q and R
whose infinite-horizon gain does the same as the policy (inverse LQR), in units of actions: what is deployed is that law,
cut off at -1 and 1, so that the loop of the proof is the loop that runs. It takes as few latent dimensions as keep the
return. What comes out proves itself: its gain is computed from A, B, Q, R whenever it is loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from koopman_lqr_controller.edmd import LinearModel, Snapshots, fit, persistence_error
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.inverse_lqr import Law, fit_costs
from koopman_lqr_controller.latent_controller import LatentController
from koopman_lqr_controller.roll_outs import (
    Environment,
    Lived,
    evaluate,
    mean_return,
    noisy_roll_outs,
    outcomes,
    saturated,
)

Array = NDArray[np.float64]

LARGEST_RESIDUAL = 1e-8
"""Of the Riccati equation, relative; what is above it is refused."""
_SEEN = 1e-4
"""Directions of the latent space that vary by less than this part of the first one say nothing but rounding."""
_FADING = 0.999
_INSIDE = 0.9
"""Largest action at the reference: the loop is linear around it."""
_SEEDS = {"live": 3_000_000, "choose": 4_000_000, "report": 5_000_000}


@dataclass(frozen=True)
class Plan:
    """How is consolidated.

    Attributes:
        episodes: lived through in each round; a fifth is kept from the fit, to measure the model.
        noise: largest standard deviation added to u, the least is none.
        rounds: the first with the learnt policy, the others with the best candidate so far, which the learnt policy
            tells what it would have done.
        ridge: of the refit, relative to each regressor's variance.
        sizes: latent dimensions that are tried; those beyond the policy's own stand for all of them.
        tolerance: part of the learnt return that may be lost for fewer dimensions.
        error: one-step error over persistence that a model with fewer dimensions may have.
        candidates: episodes of each candidate.
        report: fresh episodes, the same for the learnt policy and for what comes of it.
    """

    episodes: int = 30
    noise: float = 0.5
    rounds: int = 2
    ridge: float = 1e-4
    sizes: tuple[int, ...] = (6, 8, 12, 16, 24, 1000)
    tolerance: float = 0.01
    error: float = 1 / 3
    candidates: int = 10
    report: int = 20

    @classmethod
    def with_report(cls, episodes: int, **changes: Any) -> Plan:
        """Return a plan of so many fresh episodes, the others in proportion to them."""
        return cls(episodes=max(5, 3 * episodes // 2), candidates=max(2, episodes // 2), report=episodes, **changes)


@dataclass(frozen=True)
class Consolidated:
    """What came of it.

    Attributes:
        controller: with the infinite horizon.
        figures: learnt and consolidated returns, and what control theory says, as JSON.
    """

    controller: LatentController
    figures: dict[str, Any]


@dataclass(frozen=True)
class _Candidate:
    controller: LatentController
    score: float
    mismatch: float
    error: float


def consolidate(
    learnt: LatentController,
    environment: Environment,
    plan: Plan | None = None,
    goal: bool = True,
    seed: int = 0,
    tick: Callable[[str], None] = lambda _: None,
) -> Consolidated:
    """Return the regulator that does what a learnt controller does.

    Args:
        learnt: the controller.
        environment: where it was learnt.
        plan: how.
        goal: whether z_ref is a goal; else the middle of what the policy goes through takes its place.
        seed: of all episodes.
        tick: told what is done, once for each candidate.

    Raises:
        KoopmanError: no candidate has a regulator, or the controller is consolidated already.
    """
    if learnt.horizon is None:
        raise KoopmanError("this policy is the regulator of its own model already: give the one that `learn` made")
    plan = plan or Plan()
    first = {name: base + 10_000 * seed for name, base in _SEEDS.items()}
    learnt_score = mean_return(evaluate(learnt, environment, plan.candidates, first["choose"]))
    lived, best, acting = list[Lived](), list[_Candidate](), learnt
    for index in range(plan.rounds):
        tick(f"living through {plan.episodes} episodes")
        noises = np.linspace(0.0, plan.noise, plan.episodes)
        lived += noisy_roll_outs(acting, environment, noises.tolist(), first["live"] + 1000 * index)
        held_out = lived[::5]
        seen = [episode for number, episode in enumerate(lived) if number % 5]
        for found in _candidates(learnt, seen, plan, goal):
            score = mean_return(evaluate(found[0], environment, plan.candidates, first["choose"]))
            best.append(_Candidate(found[0], score, found[1], _error(found[0], held_out)))
            tick(f"{len(found[0].Q)} dimensions: {score:.4g} of {learnt_score:.4g}")
        if not best:
            raise KoopmanError("no regulator: the refitted model cannot be stabilised; learn longer")
        acting = max(best, key=lambda candidate: candidate.score).controller
    chosen = _choose(best, learnt_score, plan)
    before, after = (evaluate(each, environment, plan.report, first["report"]) for each in (learnt, chosen.controller))
    figures = {
        "returns": [episode.total for episode in after],
        "outcomes": outcomes(after),
        "latent": len(chosen.controller.Q),
        "mismatch": chosen.mismatch,
        "saturated": saturated(after),
        **proof(chosen.controller, held_out),
        "learnt": {
            "returns": [episode.total for episode in before],
            "outcomes": outcomes(before),
            "saturated": saturated(before),
            "spectral_radius": learnt.spectral_radius,
            "error_over_persistence": _error(learnt, held_out),
        },
        "candidates": [[len(each.controller.Q), each.score, each.mismatch, each.error] for each in best],
    }
    return Consolidated(chosen.controller, figures)


def proof(controller: LatentController, lived: Sequence[Lived]) -> dict[str, float]:
    """Return what shows that a controller is the LQR of its own model, and that the model predicts.

    Raises:
        KoopmanError: it is not.
    """
    if not (controller.spectral_radius < 1.0 and controller.residual < LARGEST_RESIDUAL):
        found = f"spectral radius {controller.spectral_radius:.4f}, Riccati residual {controller.residual:.1e}"
        raise KoopmanError(f"{found}: not the regulator of its own model")
    return {
        "spectral_radius": controller.spectral_radius,
        "dare_residual": controller.residual,
        "error_over_persistence": _error(controller, lived),
    }


def _choose(best: Sequence[_Candidate], learnt_score: float, plan: Plan) -> _Candidate:
    """Return the best of the smallest size that keeps the return and predicts; else what keeps the return best."""
    least = learnt_score - plan.tolerance * abs(learnt_score)
    good = [each for each in best if each.score >= least and each.error <= plan.error]
    if good:
        size = min(len(each.controller.Q) for each in good)
        good = [each for each in good if len(each.controller.Q) == size]
    return max(good or best, key=lambda each: each.score)


def _candidates(
    learnt: LatentController, lived: Sequence[Lived], plan: Plan, goal: bool
) -> Iterator[tuple[LatentController, float]]:
    """Yield regulators of each size with what is left of the mismatch; sizes without one are left out."""
    psi = np.concatenate([episode.features[:-1] for episode in lived])
    u = learnt.control(psi)
    effect = 1.0 - np.tanh(u) ** 2  # what a difference of u makes of the action
    weight = np.mean(effect, axis=1) + 0.05
    psi_ref, a_ref = (learnt.z_ref, np.zeros(u.shape[1])) if goal else _middle(learnt, psi, weight)
    _, spread, directions = np.linalg.svd(psi - psi_ref, full_matrices=False)
    directions = directions[spread > _SEEN * spread[0]]
    for size in sorted({min(size, len(directions)) for size in plan.sizes}):
        C = np.ascontiguousarray(directions[:size])
        z_ref = C @ psi_ref
        data = _snapshots(lived, C, z_ref, a_ref)
        law = Law.seen(psi @ C.T - z_ref, u - a_ref, weight)
        model = fit(data, plan.ridge)
        for each in (model, _contracted(model)):
            try:
                Q, R, mismatch = fit_costs(each, law, np.ones(size), learnt.R)
            except KoopmanError:
                continue
            found = LatentController(learnt.encoder, each, Q, R, z_ref, None, C, a_ref)
            if found.residual < LARGEST_RESIDUAL:
                yield found, mismatch
            break


def _middle(learnt: LatentController, psi: Array, weight: Array) -> tuple[Array, Array]:
    """Return the middle of what is met, weighted, and the law's u there.

    Where that u is beyond what actions can be, the nearest psi, by the spread of what is met, that has such a u.
    """
    psi_ref = np.average(psi, axis=0, weights=weight)
    u_ref = learnt.control(psi_ref)
    a_ref = np.clip(u_ref, -_INSIDE, _INSIDE)
    spread = np.cov(psi.T, aweights=weight) @ learnt.K.T
    shift = spread @ np.linalg.pinv(learnt.K @ spread) @ (u_ref - a_ref)
    return psi_ref + shift, a_ref


def _contracted(model: LinearModel) -> LinearModel:
    """Return a model whose modes all fade: what a weak policy never moves cannot be regulated, and need not be."""
    radius = float(np.abs(np.linalg.eigvals(model.A)).max())
    return LinearModel(model.A * min(1.0, _FADING / radius), model.B)


def _snapshots(lived: Sequence[Lived], C: Array, z_ref: Array, action_ref: Array) -> Snapshots:
    """Return the deviations that the model is fitted to."""
    z = [episode.features @ C.T - z_ref for episode in lived]
    actions = np.concatenate([episode.actions for episode in lived]) - action_ref
    return Snapshots(np.concatenate([each[:-1] for each in z]), actions, np.concatenate([each[1:] for each in z]))


def _error(controller: LatentController, lived: Sequence[Lived]) -> float:
    """Return the one-step error over that of "nothing changes", over all components."""
    z = [controller.project(episode.features) for episode in lived]
    actions = np.concatenate([episode.actions for episode in lived])
    data = Snapshots(np.concatenate([each[:-1] for each in z]), actions, np.concatenate([each[1:] for each in z]))
    missed = data.z_next - controller.predict(data.z, data.u)
    error = np.sqrt(np.mean(missed**2, axis=0))
    return float(np.linalg.norm(error) / np.linalg.norm(persistence_error(data)))
