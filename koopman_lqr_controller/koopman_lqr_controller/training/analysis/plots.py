"""The pictures of an analysis (thesis Fig. 4.4-4.7), drawn from its JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ctrl_rl_core import save_figure

Found = Mapping[str, Any]

_MODEL, _TRUE = "tab:blue", "tab:red"
_SHOWN = (1e-6, 1e4)
"""Costs to go, over that of the start: what grows further is seen to."""
_MOST = 20
"""Components of the observation that are named in a picture."""


def draw_all(found: Found, folder: Path) -> dict[str, str]:
    """Draw what was found into a folder, and return the names of the pictures by that of their part."""
    out = {}
    for part, draw in _DRAWN.items():
        if part in found:
            out[part] = f"{part}.png"
            save_figure(draw(found), folder / out[part])
    return out


def _poles(found: Found) -> Figure:
    figure, axes = plt.subplots(1, 2, figsize=(10.5, 5.2), layout="constrained")
    true = found.get("true_poles", {})
    for ax, which, title in zip(axes, ("open", "closed"), ("without control", "with the policy"), strict=True):
        turn = np.linspace(0.0, 2.0 * np.pi, 200)
        ax.plot(np.cos(turn), np.sin(turn), color="0.6", linewidth=1)
        ax.plot(*np.array(found["poles"][which]).T, "x", color=_MODEL, label="latent model")
        if true.get(which):
            ax.plot(*np.array(true[which]).T, "o", color=_TRUE, fillstyle="none", markersize=9, label="true system")
        ax.set(title=title, xlabel="real", ylabel="imaginary", aspect="equal")
        ax.grid(alpha=0.3)
        ax.legend(fontsize=8)
    figure.suptitle("poles in discrete time; inside the circle is stable")
    return figure


def _controllability(found: Found) -> Figure:
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(13.0, 4.2), layout="constrained")
    part = found["controllability"]
    left.step(part["tolerances"], part["ranks"], where="mid", color=_MODEL)
    left.axvline(part["usual_tolerance"], color="0.5", linestyle="--", label=f"usual: rank {part['usual_rank']}")
    left.set(xscale="log", xlabel="tolerance, of the largest singular value", ylabel="rank", title="Kalman's rank")
    left.legend(fontsize=8)
    sizes = np.hypot(*np.array(found["poles"]["open"]).T)
    middle.semilogy(sizes, np.maximum(part["pbh"], 1e-18), "x", color=_MODEL)
    middle.axvline(1.0, color="0.6", linewidth=1)
    middle.set(xlabel="modulus of the pole", ylabel="distance to uncontrollable", title="PBH test of each mode")
    if "latents" in found:
        variances = np.array(found["latents"]["variances"])
        right.plot(np.arange(1, len(variances) + 1), np.cumsum(variances) / variances.sum(), "o-", color=_MODEL)
        right.axhline(0.99, color="0.6", linewidth=1)
        right.set(xlabel="principal components", ylabel="share of the variance")
        right.set_title(f"what the latents use: participation ratio {found['latents']['participation_ratio']:.1f}")
    else:
        right.set_axis_off()
    return figure


def _costs(found: Found) -> Figure:
    Q = np.array(found["costs"]["Q"])
    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.6), layout="constrained", width_ratios=(1.0, 1.4))
    picture = left.imshow(np.diag(Q), cmap="viridis")
    figure.colorbar(picture, ax=left, shrink=0.8)
    left.set(title=f"Q, {found['policy']['costs']}", xlabel="column", ylabel="row")
    right.bar(np.arange(len(Q)), Q[np.argsort(-Q)], color=_MODEL)
    right.set(title="its diagonal, sorted", xlabel="latent dimensions, the heaviest first")
    return figure


def _observations(found: Found) -> Figure:
    return _patches(found) if "patch" in found["observations"] else _components(found)


def _components(found: Found) -> Figure:
    part, Q = found["observations"], np.array(found["costs"]["Q"])
    cost, link = np.array(part["cost"]), np.array(part["link"])
    figure, (left, right) = plt.subplots(1, 2, figsize=(13.0, 5.2), layout="constrained", width_ratios=(1.2, 1.0))
    picture = left.imshow(np.sqrt(Q)[np.argsort(-Q), None] * link[np.argsort(-Q)], aspect="auto", cmap="magma")
    figure.colorbar(picture, ax=left, label="sqrt(Q) |dz/dx|, x in units of its spread")
    left.set(xlabel="component of the observation", ylabel="latent dimensions, the heaviest of Q first")
    chosen = np.argsort(-cost)[:_MOST][::-1]
    right.barh([part["names"][index] for index in chosen], cost[chosen], color=_MODEL)
    right.tick_params(axis="y", labelsize=8)
    right.set(title="what Q weighs in the observation: E[J'QJ]")
    return figure


def _patches(found: Found) -> Figure:
    part = found["observations"]
    figure, axes = plt.subplots(2, len(part["pictures"]), figsize=(12.0, 6.2), layout="constrained")
    for (above, below), picture, cost in zip(axes.T, part["pictures"], part["patch_costs"], strict=True):
        image, size = np.array(picture), part["patch"]
        rows, columns = np.array(cost).shape
        above.imshow(image, cmap="gray")
        below.imshow(image, cmap="gray")
        below.imshow(cost, cmap="inferno", alpha=0.65, extent=(-0.5, columns * size - 0.5, rows * size - 0.5, -0.5))
        for ax in (above, below):
            ax.set_axis_off()
    figure.suptitle("above: what is seen; below: what hiding a patch changes of the latent state, weighed by Q")
    return figure


def _prediction(found: Found) -> Figure:
    figure, ax = plt.subplots(figsize=(6.5, 4.0), layout="constrained")
    ratio = found["prediction"]["over_persistence"]
    ax.plot(np.arange(1, len(ratio) + 1), ratio, "o-", color=_MODEL, label="the model")
    ax.axhline(1.0, color=_TRUE, label="nothing changes")
    ax.axhline(1.0 / 3.0, color="0.6", linestyle=":", linewidth=1)
    ax.set(xlabel="steps ahead", ylabel="error over that of 'nothing changes'")
    ax.set_ylim(0.0, min(5.0, 1.1 * max(1.1, *ratio)))
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.legend(fontsize=8)
    return figure


def _tsne(found: Found) -> Figure:
    figure, ax = plt.subplots(figsize=(6.0, 5.5), layout="constrained")
    for name, colour, label in (("true", _TRUE, "z of the next observation"), ("predicted", _MODEL, "predicted z")):
        x, y = np.array(found["tsne"][name]).T
        ax.scatter(x, y, s=9, color=colour, alpha=0.6, linewidths=0, label=label)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.legend(fontsize=8)
    ax.set_title("map of the latent states (t-SNE)")
    return figure


def _closed_loop(found: Found) -> Figure:
    part = found["closed_loop"]
    figure, (left, right) = plt.subplots(1, 2, figsize=(11.0, 4.2), layout="constrained")
    _traces(left, part["cost_to_go"], _TRUE, "the real system")
    _traces(left, part["cost_to_go_of_the_model_alone"], _MODEL, "the model alone")
    left.set(
        xlabel="step",
        ylabel="cost to go, over that of the start",
        yscale="log",
        title="the LQR's cost to go",
        ylim=_SHOWN,
    )
    left.legend(fontsize=8)
    for rewards in part["rewards"]:
        right.plot(np.cumsum(rewards), color=_TRUE, linewidth=1, alpha=0.7)
    right.set(xlabel="step", ylabel="return so far", title="what the task pays on the real system")
    return figure


def _traces(ax: Axes, traces: list[list[float]], colour: str, label: str) -> None:
    for index, trace in enumerate(traces):
        share = np.maximum(np.array(trace) / max(trace[0], 1e-12), 1e-9)
        ax.plot(share, color=colour, linewidth=1, alpha=0.7, label=label if index == 0 else None)


_DRAWN: Mapping[str, Callable[[Found], Figure]] = {
    "poles": _poles,
    "controllability": _controllability,
    "costs": _costs,
    "observations": _observations,
    "prediction": _prediction,
    "tsne": _tsne,
    "closed_loop": _closed_loop,
}
