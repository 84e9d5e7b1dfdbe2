"""What the commands `learn` and `compare` share: how long runs go, and where. Imports no torch."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from pathlib import Path

from ctrl_rl_core.command import check_least, folder_to_write

from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.training.experiments.methods import Changes

FOLDER = Path("runs/koopman")
CONSOLIDATION = 30
"""Episodes of each round of it, unless asked otherwise."""


def add_learning_options(parser: argparse.ArgumentParser, seeds: int) -> None:
    """Give a command what says where, how many runs and how long; `seeds` is a default."""
    parser.add_argument("--folder", type=folder_to_write, default=FOLDER, help="of the runs (default %(default)s)")
    parser.add_argument("--seeds", type=int, default=seeds, help="how many, from 0 (default %(default)s)")
    parser.add_argument("--workers", type=int, default=0, help="runs at a time (default: one for each core)")
    parser.add_argument("--chunks", type=int, default=0, help="between two evaluations each (default: the task's)")
    parser.add_argument("--actions", type=int, default=0, help="in a chunk (default: the task's)")
    parser.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=VALUE",
        help="settings of the learner, e.g. riccati_iterations=3",
    )
    parser.add_argument(
        "--episodes", type=int, default=20, help="fresh ones at the end, for each policy (default %(default)s)"
    )
    parser.add_argument(
        "--consolidation",
        type=int,
        default=CONSOLIDATION,
        help="episodes of each round of it, 0 for none (default %(default)s)",
    )
    parser.add_argument("--ray", metavar="ADDRESS", help="Ray cluster that runs them, auto for this machine's")
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"), help="of the networks (default cpu)")


def check_learning_options(options: argparse.Namespace) -> Changes:
    """Return the settings that are to be changed, and refuse counts that are too small.

    Raises:
        CommandError, KoopmanError: names the option.
    """
    check_least(options, seeds=1, workers=0, chunks=0, actions=0, episodes=1, consolidation=0)
    out: dict[str, int | float | str] = {}
    for text in options.set:
        name, separator, value = text.partition("=")
        if not (separator and value):
            raise KoopmanError(f"--set {text}: must be NAME=VALUE")
        out[name] = _value(value)
    return tuple(sorted(out.items()))


def _value(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def given_words(parser: argparse.ArgumentParser, options: argparse.Namespace, names: Sequence[str]) -> list[str]:
    """Return those of the named options that are not as they are unless asked otherwise."""
    out: list[str] = []
    for name in names:
        value = getattr(options, name)
        if value != parser.get_default(name):
            out += [f"--{name}", *(str(each) for each in (value if isinstance(value, list) else [value]))]
    return out


def as_command(*words: str) -> str:
    """Return what makes the same again."""
    return shlex.join(["ros2", "run", "koopman_lqr_controller", *words])
