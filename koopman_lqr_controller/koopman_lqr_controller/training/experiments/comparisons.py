"""The comparisons of thesis 4.3, each with the thesis's values. Imports no torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

_CARTPOLE, _PIXELS, _CHEETAH = "cartpole_swingup", "cartpole_swingup_pixels", "cheetah_run"
_TASKS = (_CARTPOLE, _PIXELS, _CHEETAH)
_ABLATIONS = ("iterations_3", "koopman", "iterations_10", "latent_30", "latent_100")
_HAND_TUNED = ("two_stage", "two_stage_q2", "two_stage_q3", "two_stage_q4", "koopman")
_SMALL = ("koopman", "latent_6", "latent_4", "network")

Figures = Mapping[tuple[str, str], tuple[float | None, float | None]]
"""Return and model error by task and method; None if not in the thesis."""


@dataclass(frozen=True)
class Comparison:
    """The runs of a table or figure.

    Attributes:
        about: Subject in one line.
        methods: Names of `methods.METHODS`.
        tasks: Tasks compared in the thesis.
        thesis: Values reported in the thesis.
        kind: "finals" (a row for each method), "levels" (returns by model error), "curves" (returns during training) or
            "gaps" (a reference return minus these).
        levels: Levels of model error, for "levels".
    """

    about: str
    methods: tuple[str, ...]
    tasks: tuple[str, ...] = (_CARTPOLE,)
    thesis: Figures = field(default_factory=dict)
    kind: str = "finals"
    levels: tuple[float, ...] = ()


REFERENCE = {_CARTPOLE: 841.0, _PIXELS: 841.0, _CHEETAH: 518.0}
"""Reference returns of Figure 4.3: those of CURL after 500,000 steps, from its paper."""

LEVELS: Mapping[tuple[str, float], float] = {
    ("two_stage", 1e-4): 188.10,
    ("two_stage", 1e-3): 107.67,
    ("two_stage", 1e-2): 64.32,
    ("koopman", 1e-4): 872.18,
    ("koopman", 1e-3): 846.88,
    ("koopman", 1e-2): 784.01,
}
"""Table 4.1: returns by method and level of model error."""


def _figures(methods: tuple[str, ...], task: str, *figures: tuple[float | None, float | None]) -> Figures:
    return {(task, method): each for method, each in zip(methods, figures, strict=True)}


COMPARISONS = {
    "table-4.1": Comparison(
        "model error against cost",
        ("two_stage", "edmd", "koopman"),
        kind="levels",
        levels=(1e-4, 1e-3, 1e-2, 1e-1, 1.0),
    ),
    "table-4.2": Comparison(
        "costs that a hand has tuned against learnt ones",
        _HAND_TUNED,
        thesis=_figures(_HAND_TUNED, _CARTPOLE, *((value, None) for value in (188.10, 109.23, 70.65, 124.80, 846.88))),
    ),
    "table-4.3": Comparison(
        "fewer latent dimensions, and a network as policy",
        _SMALL,
        thesis=_figures(_SMALL, _CARTPOLE, (846.88, 7.76e-3), (834.18, 6.3e-3), (253.80, 5.4e-2), (841.0, None)),
    ),
    "table-4.4": Comparison(
        "Riccati iterations and latent dimensions",
        _ABLATIONS,
        _TASKS,
        {
            **_figures(_ABLATIONS, _PIXELS, (863, 0.075), (873, 0.058), (835, 0.269), (848, 0.165), (813, 0.038)),
            **_figures(_ABLATIONS, _CARTPOLE, (751, 4.7e-4), (762, 3.1e-4), (769, 4.2e-4), (777, 4.3e-4), (667, 2e-4)),
            **_figures(_ABLATIONS, _CHEETAH, (436, 0.732), (464, 0.862), (448, 0.842), (477, 0.653), (235, 0.046)),
        },
    ),
    "figure-4.3": Comparison("reference cost against ours while learning", ("koopman",), _TASKS, kind="gaps"),
    "figure-4.8": Comparison(
        "other ways of learning on the same budget", ("koopman", "network", "sac"), _TASKS, kind="curves"
    ),
    "figure-4.9": Comparison(
        "contrastive encoder against autoencoders",
        ("koopman", "reconstruction", "reconstruction_prediction"),
        _TASKS,
        kind="curves",
    ),
}
"""Comparisons by table or figure of the thesis."""
