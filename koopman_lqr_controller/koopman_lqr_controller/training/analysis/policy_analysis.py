"""The analysis of a policy as JSON, from its file, its environment, and recorded or simulated episodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from ctrl_rl_core.command import what_to_install
from numpy.typing import NDArray

from ctrl_rl_core import CtrlRlError, load_navigation_task
from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.control import linear_analysis
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.prediction import horizon_errors, law_error
from koopman_lqr_controller.policies.edmd_policy import EdmdPolicy
from koopman_lqr_controller.policies.koopman_policy import LEARNT, TWO_STAGES, ClosedLoopModel
from koopman_lqr_controller.policies.latent_policy import LatentPolicy
from koopman_lqr_controller.policies.policy_file import KoopmanPolicy
from koopman_lqr_controller.training.analysis.disturbance_ablation import ablate_disturbances
from koopman_lqr_controller.training.analysis.policy_world import EpisodeTrajectory, make_world, run_episode
from koopman_lqr_controller.training.analysis.true_system import TrueSystem, corridor_system, suite_system
from koopman_lqr_controller.training.environments.control_suite import ControlSuite
from koopman_lqr_controller.training.environments.corridor import Corridor

TOLERANCES = tuple(float(10.0**power) for power in np.arange(-16.0, 0.0, 0.25))
HORIZON = 20
"""Number of steps for which the model's error is reported."""
_EQUILIBRIA = {"cartpole_swingup": 4, "cartpole_swingup_pixels": 4}
"""Tasks of the suite whose goal is the zero state, with its dimension."""
_SEED = 7_000_000
_NOISE = 0.5
_POINTS = 400
_PATCH = 8
_LOOKED_AT = 200
"""Number of observations at which Jacobians are computed."""
_PART_STEP = 5e-3
"""Step size of a Jacobian relative to a component's spread, limited by single-precision encoders."""


def analyse(
    policy: KoopmanPolicy,
    world: Any,
    recorded: Sequence[EpisodeTrajectory] = (),
    episodes: int = 6,
    on_progress: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Return the full analysis of a policy.

    Args:
        policy: Koopman policy of either kind.
        world: The policy's environment, or an error with the reason why there is none.
        recorded: Drives from bags, used for prediction and observations if given.
        episodes: Number of episodes to run in the environment, and again with noise.
        on_progress: Called with the name of each part before it starts.
    """
    loop, parts, left_out = policy.closed_loop_model(), dict[str, Any](), dict[str, str]()

    def add(name: str, find: Callable[[], dict[str, Any]]) -> None:
        try:
            parts[name] = find()
        except ModuleNotFoundError as error:
            left_out[name] = what_to_install(str(error.name))
        except CtrlRlError as error:
            left_out[name] = str(error)

    add("policy", lambda: _policy(policy, loop))
    on_progress("poles")
    add("poles", lambda: _poles(loop))
    add("true_poles", lambda: _true_poles(policy, loop, world))
    on_progress("controllability")
    add("controllability", lambda: _controllability(loop))
    add("costs", lambda: {"Q": loop.Q.tolist(), "R": loop.R.tolist()})
    quiet: list[EpisodeTrajectory] = []
    noisy: list[EpisodeTrajectory] = []
    if not isinstance(world, CtrlRlError):
        for index in range(episodes):
            on_progress(f"episode {index + 1} of {episodes}")
            quiet.append(run_episode(loop, world, _SEED + index))
            noisy.append(run_episode(loop, world, _SEED + episodes + index, _NOISE * (index + 1) / episodes))
    data = [*recorded] or [*quiet, *noisy]
    add("data", lambda: _data(data, bool(recorded), world))
    on_progress("prediction")
    add("prediction", lambda: _prediction(loop, _some(data, world)))
    if isinstance(world, Corridor):
        add("limits", lambda: _limits(policy, loop, episodes, on_progress))
    add("latents", lambda: _latents(loop, _some(data, world)))
    add("observations", lambda: _observations(policy, loop, _some(data, world), world))
    on_progress("t-SNE")
    add("tsne", lambda: _tsne(loop, _some(data, world)))
    add("closed_loop", lambda: _closed_loop(loop, _some(quiet, world)))
    return {**parts, "left_out": left_out}


def _some(data: Sequence[EpisodeTrajectory], world: Any) -> Sequence[EpisodeTrajectory]:
    if not data:
        raise world if isinstance(world, CtrlRlError) else KoopmanError("no episode was completed")
    return data


def _policy(policy: KoopmanPolicy, loop: ClosedLoopModel) -> dict[str, Any]:
    n, m = loop.model.B.shape
    plain = loop.model.A - loop.model.B @ loop.K
    return {
        "kind": loop.kind,
        "task": policy.manifest.get("task"),
        "latent": n,
        "controls": m,
        "dt": policy.dt,
        "riccati_iterations": policy.controller.horizon if isinstance(policy, LatentPolicy) else None,
        "spectral_radius": float(np.abs(linear_analysis.poles(plain)[0])),
        "slope": loop.slope.tolist(),
        "costs": "as learnt" if loop.kind == LEARNT else "by hand" if loop.kind == TWO_STAGES else "by inverse LQR",
    }


def _poles(loop: ClosedLoopModel) -> dict[str, Any]:
    return {"open": _pairs(linear_analysis.poles(loop.model.A)), "closed": _pairs(linear_analysis.poles(loop.closed))}


def _true_poles(policy: KoopmanPolicy, loop: ClosedLoopModel, world: Any) -> dict[str, Any]:
    if isinstance(world, CtrlRlError):
        raise world
    true = _true_system(policy, world)
    out = {
        "about": true.about,
        "open": _pairs(true.open_poles),
        "nearest_open": linear_analysis.distances_to_nearest(
            true.open_poles, linear_analysis.poles(loop.model.A)
        ).tolist(),
        "closed": None,
        "why": true.why,
    }
    if true.closed_poles is not None and true.rest is not None:
        nearest = linear_analysis.distances_to_nearest(true.closed_poles, linear_analysis.poles(loop.closed))
        out |= {"closed": _pairs(true.closed_poles), "nearest_closed": nearest.tolist(), "rest": true.rest.tolist()}
    return out


def _true_system(policy: KoopmanPolicy, world: Any) -> TrueSystem:
    task = str(policy.manifest.get("task"))
    if isinstance(world, Corridor):
        known = load_navigation_task(task)
        width = known.build_world(None).width
        if width is None:
            raise KoopmanError(f"task {task} has no corridor")
        speed = float(policy.z_ref[-1]) if isinstance(policy, EdmdPolicy) else 0.2
        return corridor_system(policy, width, policy.dt or known.episode.time_step, speed)
    if isinstance(world, ControlSuite) and isinstance(policy, LatentPolicy) and task in _EQUILIBRIA:
        return suite_system(world, np.zeros(_EQUILIBRIA[task]), policy)
    raise KoopmanError(f"task {task} has no equilibrium to linearise at")


def _controllability(loop: ClosedLoopModel) -> dict[str, Any]:
    values = linear_analysis.controllability_values(loop.model)
    usual = len(values) * np.finfo(float).eps
    return {
        "values": values.tolist(),
        "tolerances": list(TOLERANCES),
        "ranks": linear_analysis.ranks(values, TOLERANCES),
        "usual_tolerance": usual,
        "usual_rank": linear_analysis.ranks(values, [usual])[0],
        "participation_ratio": linear_analysis.participation_ratio(values**2),
        "pbh": linear_analysis.pbh_distances(loop.model).tolist(),
    }


def _data(data: Sequence[EpisodeTrajectory], recorded: bool, world: Any) -> dict[str, Any]:
    steps = sum(len(episode.u) for episode in _some(data, world))
    source = "bags" if recorded else f"its own environment, with noise of up to {_NOISE:g} on half of the episodes"
    return {"source": source, "episodes": len(data), "steps": steps}


def _prediction(loop: ClosedLoopModel, data: Sequence[EpisodeTrajectory]) -> dict[str, Any]:
    z, u = [loop.latent(episode.x) for episode in data], [episode.u for episode in data]
    return {
        "over_persistence": horizon_errors(loop.predict, z, u, HORIZON),
        "law_over_persistence": law_error(loop.predict, loop.gain, z, u),
    }


def _limits(
    policy: KoopmanPolicy, loop: ClosedLoopModel, episodes: int, on_progress: Callable[[str], None]
) -> dict[str, Any]:
    count = max(1, episodes // 3)
    return {
        "rows": ablate_disturbances(loop, partial(make_world, policy), (0.0, _NOISE), count, on_progress=on_progress)
    }


def _latents(loop: ClosedLoopModel, data: Sequence[EpisodeTrajectory]) -> dict[str, Any]:
    found = linear_analysis.variances(np.concatenate([loop.latent(episode.x) for episode in data]))
    return {
        "variances": found.tolist(),
        "participation_ratio": linear_analysis.participation_ratio(found),
        "components_99": linear_analysis.components_for(found, 0.99),
    }


def _observations(
    policy: KoopmanPolicy, loop: ClosedLoopModel, data: Sequence[EpisodeTrajectory], world: Any
) -> dict[str, Any]:
    x = np.concatenate([episode.x for episode in data])
    if x.ndim > 2:
        return _patches(loop, x)
    some = x[np.linspace(0, len(x) - 1, min(len(x), _LOOKED_AT)).astype(int)].astype(np.float64)
    spread = x.std(axis=0).astype(np.float64)

    def at(point: Array) -> Array:
        return linear_analysis.jacobian(lambda parts: loop.latent(point + parts * spread), 0.0 * spread, _PART_STEP)

    jacobians = np.array([at(point) for point in some])
    cost = linear_analysis.observation_cost(jacobians, loop.Q)
    return {
        "names": list(_names(policy, world, len(spread))),
        "spread": spread.tolist(),
        "cost": np.diag(cost).tolist(),
        "link": np.sqrt(np.mean(jacobians**2, axis=0)).tolist(),
    }


def _patches(loop: ClosedLoopModel, x: NDArray[Any]) -> dict[str, Any]:
    """Return the cost of hiding patches in a few images, spread over the observations."""
    chosen = x[np.linspace(0, len(x) - 1, 4).astype(int)].astype(np.float64)
    costs = [linear_analysis.patch_costs(loop.latent, each, loop.Q, _PATCH, float(np.median(each))) for each in chosen]
    return {"patch": _PATCH, "pictures": chosen[:, -1].tolist(), "patch_costs": [each.tolist() for each in costs]}


def _names(policy: KoopmanPolicy, world: Any, count: int) -> Sequence[str]:
    if isinstance(policy, EdmdPolicy):
        return policy.observables.names
    if policy.robot_interface is not None:
        return policy.robot_interface.observation.names
    names: Sequence[str] = getattr(world, "names", ())
    return names or [f"x {index}" for index in range(count)]


def _tsne(loop: ClosedLoopModel, data: Sequence[EpisodeTrajectory]) -> dict[str, Any]:
    from sklearn.manifold import TSNE

    z = [loop.latent(episode.x) for episode in data]
    true = np.concatenate([each[1:] for each in z])
    predicted = np.concatenate([loop.predict(each[:-1], episode.u) for each, episode in zip(z, data, strict=True)])
    chosen = np.linspace(0, len(true) - 1, min(len(true), _POINTS)).astype(int)
    if len(chosen) < 10:
        raise KoopmanError("too few steps for a map of them")
    both = np.concatenate((true[chosen], predicted[chosen]))
    points = TSNE(perplexity=min(30.0, len(chosen) / 3), init="pca", random_state=0).fit_transform(both)
    return {"true": points[: len(chosen)].tolist(), "predicted": points[len(chosen) :].tolist()}


def _closed_loop(loop: ClosedLoopModel, quiet: Sequence[EpisodeTrajectory]) -> dict[str, Any]:
    """Return the behaviour of the real system under the policy, and the prediction of the lifted model alone."""
    real, lifted = [], []
    for episode in quiet:
        z = loop.latent(episode.x)
        real.append(loop.cost_to_go(z).tolist())
        promised = [z[0]]
        for _ in range(len(z) - 1):
            promised.append(loop.predict(promised[-1][None], loop.control(promised[-1])[None])[0])
        lifted.append(loop.cost_to_go(np.array(promised)).tolist())
    return {
        "returns": [float(episode.rewards.sum()) for episode in quiet],
        "outcomes": [episode.info["outcome"] for episode in quiet if "outcome" in episode.info],
        "rewards": [episode.rewards.tolist() for episode in quiet],
        "cost_to_go": real,
        "cost_to_go_of_the_model_alone": lifted,
    }


def _pairs(values: linear_analysis.Poles) -> list[list[float]]:
    """Convert complex numbers to JSON pairs."""
    return [[float(value.real), float(value.imag)] for value in values]
