"""Where a run leaves what it learnt."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from ctrl_rl_core.io import Anything, Schema, one_line, raise_as, read_json, short_path
from pydantic import ConfigDict, Field, field_validator

from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.study.run import Run


class _Point(Schema):
    """What a curve says of an iteration: the learner's own words, and these."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=True)

    seconds: float = 0.0
    cpu_seconds: float = 0.0


class Progress(Schema):
    """What a checkpoint says of a run, besides what its learner keeps for itself."""

    model_config = ConfigDict(extra="allow")

    run: Anything
    curve: Annotated[list[Anything], Field(max_length=1_000_000)]

    @field_validator("curve")
    @classmethod
    def _points(cls, curve: list[Anything]) -> list[Anything]:
        for point in curve:
            _Point.model_validate(point)
        return curve


class Finished(Progress):
    """What a finished run leaves."""

    cpu_seconds: float = 0.0


def result_file(folder: Path, run: Run) -> Path:
    """Return the file that says that a run is finished, and how it went."""
    return folder / run.name / "result.json"


def read_result(file: Path) -> dict[str, Any]:
    """Return what a finished run left, see `result_file`: at least its `run` and its `curve`.

    Raises:
        LearningError: the file is damaged.
    """
    with raise_as(LearningError, file, "is not what a finished run leaves: delete it to have it learnt again"):
        result: dict[str, Any] = read_json(file)
        Finished.model_validate(result)
    return result


def check_same(file: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Refuse a file of a run that was another one.

    Raises:
        LearningError: names the first difference.
    """
    for name, value in now.items():
        if before.get(name) != value:
            raise LearningError(
                f"{short_path(file)}: was made with {name} {one_line(before.get(name), 100)}, now it is "
                f"{one_line(value, 100)}: use another folder, or delete it"
            )
