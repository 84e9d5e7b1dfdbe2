"""Curves of last policies, joined where several commands share the seeds, and what others publish beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from ctrl_rl_core.io.results import read_experiment
from ctrl_rl_core.io.schema import Name, Schema
from ctrl_rl_training.experiments.figure_data import Figures, ValueCurve
from ctrl_rl_training.experiments.results import read_figures
from pydantic import Field, model_validator

PUBLISHED: Mapping[str, Mapping[str, Mapping[int, float]]] = {
    "cheetah_run": {
        "MR.Q": {100_000: 648, 350_000: 881},
        "SimbaV2": {100_000: 642, 350_000: 860},
        "TD-MPC2": {100_000: 519, 500_000: 758},
        "SAC": {100_000: 178, 350_000: 586},
    },
    "cartpole_swingup": {"SimbaV2": {100_000: 880}, "MR.Q": {100_000: 853}},
    "cartpole_swingup_pixels": {"DrQ-v2": {100_000: 626, 200_000: 807, 500_000: 846}},
}
"""Mean returns that others publish after so many simulated frames, by task and method."""


class SeedCurves(Schema):
    """Returns after so many frames (`samples`), the seeds' numbers, and the digest of all else that made them."""

    curve: ValueCurve
    seeds: Annotated[list[int], Field(min_length=1, max_length=10_000)]
    terms: Name

    @model_validator(mode="after")
    def _one_a_seed(self) -> SeedCurves:
        if len(set(self.seeds)) != len(self.curve.values):
            raise ValueError("seeds: must be one a curve")
        return self


class LastPolicies(Figures):
    """Curves of a file of `train --keep last --results`, by method."""

    last_policies: Annotated[dict[Name, SeedCurves], Field(min_length=1, max_length=100)]


def collect_curves(method: str, terms: str, results: Sequence[Mapping[str, Any]], file: Path) -> dict[str, Any]:
    """Return the figures' data of a results file with the curves of new seeds.

    Args:
        method: Name of the curves.
        terms: Digest of all that made them but the seed. Curves that other terms made are replaced; of these, those of
            other seeds stay.
        results: Results of `train`, one a seed.
        file: Results file, which need not be there.

    Raises:
        ResultsError: The file cannot be read.
    """
    before = read_experiment(file) if file.exists() else None
    curves: dict[str, Any] = read_figures(file, LastPolicies)["last_policies"] if before and before.figures else {}
    frames = [float(point["steps"]) for point in results[0]["curve"]]
    values = {each["run"]["seed"]: [kept_return(point) for point in each["curve"]] for each in results}
    old = curves.get(method)
    if old and old["terms"] == terms and old["curve"]["samples"] == frames:
        values = {**dict(zip(old["seeds"], old["curve"]["values"], strict=True)), **values}
    seeds = sorted(values)
    curve = {"samples": frames, "values": [values[seed] for seed in seeds]}
    curves[method] = {"curve": curve, "seeds": seeds, "terms": terms}
    return {"task": "last_policies", "last_policies": curves}


def kept_return(point: Mapping[str, Any]) -> float:
    """Return what the policy that would be kept had at a point of the curve: the first candidate."""
    return float(next(iter(point["returns"].values())))
