"""Curves of last policies, merged over commands with different seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from ctrl_rl_core.io import Name, Schema, read_experiment
from ctrl_rl_learning.study import Figures, ValueCurve, read_figures
from pydantic import Field, model_validator

from koopman_lqr_controller.errors import KoopmanError


class SeedCurves(Schema):
    """Returns after numbers of frames (`samples`), seeds, and the digest of all other settings."""

    curve: ValueCurve
    seeds: Annotated[list[int], Field(min_length=1, max_length=10_000)]
    terms: Name

    @model_validator(mode="after")
    def _one_a_seed(self) -> SeedCurves:
        if len(set(self.seeds)) != len(self.curve.values):
            raise ValueError("seeds: must be one a curve")
        return self


class LastPolicies(Figures):
    """Curves in a file of `train --keep last --results`, by method."""

    last_policies: Annotated[dict[Name, SeedCurves], Field(min_length=1, max_length=100)]


def read_curves(file: Path) -> dict[str, Any]:
    """Read the curves of a results file by method; empty without a file or without curves.

    Raises:
        ResultsError: The file cannot be read.
        KoopmanError: The file has curves of another kind.
    """
    before = read_experiment(file) if file.exists() else None
    if before is None or before.figures is None:
        return {}
    if "last_policies" not in before.figures:
        raise KoopmanError(f"{file}: holds other curves than those of `train --keep last`: name another file")
    return dict(read_figures(file, LastPolicies)["last_policies"])


def collect_curves(method: str, terms: str, results: Sequence[Mapping[str, Any]], file: Path) -> dict[str, Any] | None:
    """Return the figure data of a results file extended by the curves of new seeds; None without curves.

    Seeds evaluated after different numbers of frames, as with an episode budget, have no common curve.

    Args:
        method: Name of the curves.
        terms: Digest of all settings except the seed. Curves with another digest are replaced; those with this digest
            are kept for other seeds.
        results: Results of `train`, one per seed.
        file: Results file, which need not exist.

    Raises:
        ResultsError: The file cannot be read.
        KoopmanError: The file has curves of another kind.
    """
    curves = read_curves(file)
    old = curves.pop(method, None)
    frames, *others = ([float(point["steps"]) for point in each["curve"]] for each in results)
    if all(each == frames for each in others):
        values = {each["run"]["seed"]: [shown_return(point) for point in each["curve"]] for each in results}
        if old and old["terms"] == terms and old["curve"]["samples"] == frames:
            values = {**dict(zip(old["seeds"], old["curve"]["values"], strict=True)), **values}
        seeds = sorted(values)
        curve = {"samples": frames, "values": [values[seed] for seed in seeds]}
        curves[method] = {"curve": curve, "seeds": seeds, "terms": terms}
    return {"task": "last_policies", "last_policies": curves} if curves else None


def shown_return(point: Mapping[str, Any]) -> float:
    """Return the value shown in curves: the return of the averaged actor, or of the only candidate.

    The name is needed because checkpoints do not preserve the order of candidates.
    """
    returns = point["returns"]
    return float(returns["averaged"] if "averaged" in returns else next(iter(returns.values())))
