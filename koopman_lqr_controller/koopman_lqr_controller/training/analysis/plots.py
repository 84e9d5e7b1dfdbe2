"""The figures of an analysis (thesis Fig. 4.4-4.7), drawn from its JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.plots import BLACK, FAINT, GREY_MAP, OURS_COLOUR, VALUE_MAP, legend_below, name_at_end, picture
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

Found = Mapping[str, Any]

_SHOWN = (1e-6, 1e4)
"""Cost-to-go relative to the start above which curves are cut off."""
_MOST = 16
"""Maximum number of observation components labelled in a figure."""
_PICTURES = 3
"""Number of camera images to show."""


def draw_all(found: Found, folder: Path) -> dict[str, str]:
    """Draw all findings to a folder, and return the names of the figures by part."""
    out = {}
    for part, (draw, kind) in _DRAWN.items():
        if part in found:
            out[part] = f"{part}.{kind}"
            draw(found, folder / out[part])
    return out


def _poles(found: Found, path: Path) -> None:
    true = found.get("true_poles", {})
    farthest = [np.hypot(*np.array(found["poles"][which]).T).max() for which in ("open", "closed")]
    title = f"Farthest pole of the model: {farthest[0]:.3f} without control, {farthest[1]:.3f} with the policy"
    with picture(path, title, 1, 2, height=4.2) as (figure, axes):
        for ax, which, name in zip(axes[0], ("open", "closed"), ("without control", "with the policy"), strict=True):
            turn = np.linspace(0.0, 2.0 * np.pi, 200)
            ax.plot(np.cos(turn), np.sin(turn), color=FAINT, linewidth=0.8, label="inside is stable")
            ax.plot(*np.array(found["poles"][which]).T, "x", color=OURS_COLOUR, label="latent model")
            if true.get(which):
                look = {"color": BLACK, "fillstyle": "none", "markersize": 9}
                ax.plot(*np.array(true[which]).T, "o", **look, label="true system")
            ax.set(title=name, xlabel="real", ylabel="imaginary", aspect="equal")
            ax.label_outer()
        legend_below(figure)


def _controllability(found: Found, path: Path) -> None:
    part = found["controllability"]
    title = f"Rank {part['usual_rank']} at the usual tolerance; least mode {min(part['pbh']):.1e} from uncontrollable"
    with picture(path, title, 1, 3 if "latents" in found else 2, height=2.8) as (_, ((left, middle, *right),)):
        left.step(part["tolerances"], part["ranks"], where="mid", color=OURS_COLOUR)
        left.axvline(part["usual_tolerance"], color=FAINT, linewidth=0.8)
        left.set(xscale="log", xlabel="relative tolerance;\ngrey: the usual one", title="Kalman's rank")
        sizes = np.hypot(*np.array(found["poles"]["open"]).T)
        middle.semilogy(sizes, np.maximum(part["pbh"], 1e-18), "x", color=OURS_COLOUR)
        middle.axvline(1.0, color=FAINT, linewidth=0.8)
        middle.set(xlabel="modulus of the pole", title="distance to uncontrollable")
        for ax in right:
            variances = np.array(found["latents"]["variances"])
            share = 100.0 * np.cumsum(variances) / variances.sum()
            ax.plot(np.arange(1, len(variances) + 1), share, color=OURS_COLOUR)
            ax.axhline(99.0, color=FAINT, linewidth=0.8)
            ax.set(xlabel="principal components;\ngrey: 99 %", title="variance of the latents [%]")


def _costs(found: Found, path: Path) -> None:
    Q = np.sort(np.array(found["costs"]["Q"]))[::-1]
    half = int(np.searchsorted(np.cumsum(Q) / max(Q.sum(), 1e-300), 0.5) + 1)
    with picture(path, f"{half} of {len(Q)} entries hold half of Q", height=2.4) as (_, ((ax,),)):
        ax.bar(np.arange(1, len(Q) + 1), Q, color=OURS_COLOUR)
        ax.set(xlabel=f"latent dimensions, the heaviest first; {found['policy']['costs']}", ylabel="entry of Q")


def _observations(found: Found, path: Path) -> None:
    (_patches if "patch" in found["observations"] else _components)(found, path)


def _components(found: Found, path: Path) -> None:
    part, Q = found["observations"], np.array(found["costs"]["Q"])
    cost, link = np.array(part["cost"]), np.array(part["link"])
    chosen = np.argsort(-cost)[:_MOST][::-1]
    title = f"Q weighs most: {part['names'][chosen[-1]]}"
    with picture(path, title, 1, 2, height=3.6, width_ratios=(1.0, 0.8)) as (figure, ((left, right),)):
        image = left.imshow(np.sqrt(Q)[np.argsort(-Q), None] * link[np.argsort(-Q)], aspect="auto", cmap=VALUE_MAP)
        figure.colorbar(image, ax=left, label=r"$\sqrt{Q}\,|dz/dx|$, x by its spread")
        left.set(xlabel="component of the observation", ylabel="latent, the heaviest of Q first")
        left.grid(visible=False)
        right.barh([part["names"][index] for index in chosen], cost[chosen], color=OURS_COLOUR)
        right.set(title="E[J'QJ] of each component")
        right.grid(visible=False)


def _patches(found: Found, path: Path) -> None:
    part = found["observations"]
    shown = list(zip(part["pictures"], part["patch_costs"], strict=True))[:_PICTURES]
    title = "What is seen, and what hiding a patch of it changes of the latent state, weighed by Q"
    with picture(path, title, 2, len(shown), height=4.8) as (_, axes):
        for (above, below), (camera, cost) in zip(axes.T, shown, strict=True):
            size, (rows, columns) = part["patch"], np.array(cost).shape
            above.imshow(np.array(camera), cmap=GREY_MAP)
            below.imshow(np.array(camera), cmap=GREY_MAP)
            extent = (-0.5, columns * size - 0.5, rows * size - 0.5, -0.5)
            below.imshow(cost, cmap=VALUE_MAP, alpha=0.65, extent=extent)
            for ax in (above, below):
                ax.set_axis_off()


def _prediction(found: Found, path: Path) -> None:
    ratio = found["prediction"]["over_persistence"]
    title = f"One step ahead the model's error is {ratio[0]:.2f} of that of 'nothing changes'"
    with picture(path, title, height=2.6) as (_, ((ax,),)):
        ax.plot(np.arange(1, len(ratio) + 1), ratio, "o-", color=OURS_COLOUR)
        ax.axhline(1.0, color=FAINT, linewidth=0.8)
        top = min(5.0, 1.1 * max(1.1, *ratio))
        name_at_end(ax, "the model", min(ratio[-1], top), OURS_COLOUR)
        name_at_end(ax, "nothing changes", 1.0, FAINT)
        ax.set(xlabel="steps ahead", ylabel="relative error", ylim=(0.0, top))
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))


def _tsne(found: Found, path: Path) -> None:
    with picture(path, "Map of the latent states (t-SNE)", height=4.4) as (figure, ((ax,),)):
        for name, colour, marker, label in (
            ("true", BLACK, "o", "z of the next observation"),
            ("predicted", OURS_COLOUR, "x", "z as predicted"),
        ):
            x, y = np.array(found["tsne"][name]).T
            ax.plot(x, y, marker, color=colour, markersize=3, alpha=0.6, label=label)
        ax.set_xticks([])
        ax.set_yticks([])
        legend_below(figure)


def _closed_loop(found: Found, path: Path) -> None:
    part = found["closed_loop"]
    returns = np.array(part["returns"])
    title = f"{len(returns)} episodes of the real system: return {returns.mean():.1f} on average"
    with picture(path, title, 1, 2, height=3.2) as (figure, ((left, right),)):
        _traces(left, part["cost_to_go"], BLACK, "-", "the real system")
        _traces(left, part["cost_to_go_of_the_model_alone"], OURS_COLOUR, "--", "the model alone")
        left.set(xlabel="step", yscale="log", ylim=_SHOWN, title="the LQR's cost to go, over the start's")
        for rewards in part["rewards"]:
            right.plot(np.cumsum(rewards), color=BLACK, linewidth=0.7)
        right.set(xlabel="step", title="return so far on the real system")
        legend_below(figure)


def _traces(ax: Axes, traces: list[list[float]], colour: str, line: str, label: str) -> None:
    for index, trace in enumerate(traces):
        share = np.maximum(np.array(trace) / max(trace[0], 1e-12), 1e-9)
        ax.plot(share, line, color=colour, linewidth=0.7, label=label if index == 0 else None)


_DRAWN: Mapping[str, tuple[Callable[[Found, Path], None], str]] = {
    "poles": (_poles, "svg"),
    "controllability": (_controllability, "svg"),
    "costs": (_costs, "svg"),
    "observations": (_observations, "png"),
    "prediction": (_prediction, "svg"),
    "tsne": (_tsne, "png"),
    "closed_loop": (_closed_loop, "svg"),
}
"""Drawing functions and figure kinds, by part."""
