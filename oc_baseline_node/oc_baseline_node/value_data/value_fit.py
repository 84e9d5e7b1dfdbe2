"""Fits V_oc to value data: an MLP with 64 x 64 tanh units, tested on held-out trajectories (3.3.2)."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np
import torch
from ctrl_rl_core.values import Axis
from numpy.typing import NDArray
from torch import nn
from tqdm import tqdm

from oc_baseline_node.errors import OcError
from oc_baseline_node.problems.problem import OptimalControlProblem
from oc_baseline_node.problems.start_states import state_space
from oc_baseline_node.value_data.dataset import ValueData
from oc_baseline_node.values.collision_set import CollisionSet
from oc_baseline_node.values.mlp_value import MlpValue, features

Array = NDArray[np.float64]
_FINE = {"position": 81, "angle": 36, "rate": 21}
_COARSE = {"position": 21, "angle": 18, "rate": 7}
_TESTED = 80
"""Number of test trajectories, if enough: large errors are rare, so a small test set may contain none."""
_MOST_FOLDS = 5
_RESAMPLED = 1000
_LARGE = 3
"""Maximum number of state components for a fine grid."""


@dataclass(frozen=True)
class FitSettings:
    """Settings of the fit.

    Attributes:
        discount: Discount per policy step, in Eq. 3.13; the task's own by default.
        whole_horizon: Whether Eq. 3.13 is summed beyond arrival.
        hidden: Number of units of each hidden layer.
        epochs: Number of passes over the data.
        batch: Minibatch size.
        learning_rate: Initial learning rate, with cosine decay.
        held_out: Fraction of the trajectories held out for the test.
        seed: Seed of the split, the weights and the order of the samples.
    """

    discount: float | None = None
    whole_horizon: bool = False
    hidden: tuple[int, ...] = (64, 64)
    epochs: int = 200
    batch: int = 512
    learning_rate: float = 5e-3
    held_out: float = 0.1
    seed: int = 0


def fit(
    problem: OptimalControlProblem, data: ValueData, settings: FitSettings | None = None, progress: bool = True
) -> MlpValue:
    """Fit V_oc to value data up to each arrival; the manifest has the error on held-out trajectories.

    If a tenth of the trajectories is too small a test set, up to four more networks are fitted in the same way with
    other trajectories held out, and the error covers all of them.

    Args:
        problem: Optimal control problem of the data.
        data: Trajectories; the samples are the states visited by an episode.
        settings: Settings of the fit; the default ones if omitted.
        progress: Whether to show a progress bar.

    Raises:
        OcError: There are too few trajectories to hold any out.
    """
    settings = settings or FitSettings()
    discount = problem.discount if settings.discount is None else settings.discount
    random = np.random.default_rng(settings.seed)
    states, values, met = data.samples(problem, discount, settings.whole_horizon)
    met[:, -1] &= not settings.whole_horizon  # the last state then only terminates the sum
    count = len(states)
    order, size = random.permutation(count), round(settings.held_out * count)
    if not 0 < size < count:
        raise OcError(f"{count} trajectories are too few to hold {settings.held_out:.0%} of them out: make more")
    folds = max(1, min(count // size, -(-_TESTED // size), _MOST_FOLDS))
    axes, networks = domain(problem, states), []
    errors = [np.empty(0)] * count
    for fold in range(folds):
        held = order[fold * size : (fold + 1) * size]
        seen = met.copy()
        seen[held] = False
        networks.append(_fit_once(problem, axes, states[seen], values[seen], settings, progress))
        for index in held:
            errors[index] = _error(networks[-1], states[index][met[index]], values[index][met[index]])
    network, tested = networks[0], order[: folds * size]
    seen = met.copy()
    seen[order[:size]] = False
    manifest = {
        "discount": discount,
        "fit": {**asdict(settings), "hidden": list(settings.hidden)},
        "data": {"trajectories": count, "states": int(met.sum()), "starts": data.starts, "dropped": data.dropped},
        "clearance": problem.clearance,
        "form": problem.form,
        "held_out": {
            **_figures(np.concatenate([errors[k] for k in tested]), values[tested][met[tested]]),
            **_uncertainty([errors[k] for k in tested], random),
            "trajectories": len(tested),
        },
        "fitted": _figures(_error(network, states[seen], values[seen]), values[seen]),
    }
    return replace(network, manifest=manifest)


def _fit_once(
    problem: OptimalControlProblem, axes: tuple[Axis, ...], x: Array, y: Array, settings: FitSettings, progress: bool
) -> MlpValue:
    """Fit a network to values (N,) at states (N, n)."""
    offset, scale = float(y.mean()), float(max(y.std(), 1e-9))
    inputs = features(axes, x)
    middle, spread = inputs.mean(axis=0), np.maximum(inputs.std(axis=0), 1e-6)
    (weight, bias), *rest = _train((inputs - middle) / spread, (y - offset) / scale, settings, progress)
    # The standardisation of the inputs is merged into the first layer.
    layers = ((weight / spread, bias - (weight / spread) @ middle), *rest)
    return MlpValue(layers, axes, offset, scale, problem.task.name, problem.digest, CollisionSet.of(problem.task))


def domain(problem: OptimalControlProblem, reached: Array) -> tuple[Axis, ...]:
    """Return the axes of V_oc: the area within walls, full turns, and the range of rates in trajectories (..., n)."""
    space = state_space(problem)
    components, walls = problem.task.system.build().states, problem.task.plane_bounds
    counts = _FINE if len(components) <= _LARGE else _COARSE
    axes = []
    for index, state in enumerate(components):
        kind = "position" if state.name in walls else "angle" if state.periodic else "rate"
        if state.name in walls:
            low, high = walls[state.name]
        elif state.periodic:
            low, high = state.lower, state.upper
        else:
            low = min(float(space[0, index]), math.floor(float(reached[..., index].min())))
            high = max(float(space[1, index]), math.ceil(float(reached[..., index].max())))
        asked = problem.task.grid.get(state.name)
        count = counts[kind] if asked is None else asked.count
        axes.append(Axis(state.name, state.unit, low, high, count, state.periodic))
    return tuple(axes)


def _train(x: Array, y: Array, settings: FitSettings, progress: bool) -> tuple[tuple[Array, Array], ...]:
    """Train layers to map x (N, F) to y (N,), both standardised; return weights and biases."""
    torch.set_num_threads(1)  # more threads slow down small layers
    generator = torch.Generator().manual_seed(settings.seed)
    linears = [nn.Linear(a, b) for a, b in zip((x.shape[1], *settings.hidden), (*settings.hidden, 1), strict=True)]
    with torch.no_grad():
        for linear in linears:
            nn.init.xavier_uniform_(linear.weight, generator=generator)
            linear.bias.zero_()
    network = nn.Sequential(*(part for linear in linears for part in (linear, nn.Tanh())))[:-1]
    samples, targets = torch.tensor(x, dtype=torch.float32), torch.tensor(y, dtype=torch.float32)[:, None]
    optimiser = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    steps = settings.epochs * math.ceil(len(samples) / settings.batch)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    bar = tqdm(range(settings.epochs), desc="fitting", unit="epoch", disable=None if progress else True)
    for _ in bar:
        order = torch.randperm(len(samples), generator=generator)
        total = 0.0
        for part in torch.split(order, settings.batch):
            loss = nn.functional.mse_loss(network(samples[part]), targets[part])
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            schedule.step()
            total += float(loss.detach()) * len(part)
        bar.set_postfix(loss=f"{total / len(samples):.2g}")
    return tuple(
        (linear.weight.detach().numpy().astype(np.float64), linear.bias.detach().numpy().astype(np.float64))
        for linear in linears
    )


def _error(network: MlpValue, states: Array, values: Array) -> Array:
    """Return the absolute error (N,) [reward] at states (N, n)."""
    out: Array = np.abs(network.without_collisions().value(network.clipped(states)) - values)
    return out


def _uncertainty(errors: list[Array], random: np.random.Generator) -> dict[str, float]:
    """Return the bootstrapped 95 % interval of the mean absolute error [reward] over trajectories."""
    sums, counts = np.array([error.sum() for error in errors]), np.array([len(error) for error in errors])
    drawn = random.integers(len(errors), size=(_RESAMPLED, len(errors)))
    means = sums[drawn].sum(axis=1) / np.maximum(counts[drawn].sum(axis=1), 1)
    low, high = np.percentile(means, (2.5, 97.5))
    return {"mae_low": float(low), "mae_high": float(high)}


def _figures(error: Array, values: Array) -> dict[str, float]:
    """Return root mean square, mean absolute and 95th percentile error [reward], and the values' standard deviation."""
    return {
        "rmse": float(np.sqrt(np.mean(error**2))),
        "mae": float(error.mean()),
        "p95": float(np.percentile(error, 95)),
        "std_of_values": float(values.std()),
    }
