"""What pictures of learning are drawn from, as results files hold it: types and sizes that can be drawn."""

from __future__ import annotations

from typing import Annotated

from ctrl_rl_core.io import Name, Schema
from pydantic import ConfigDict, Field, model_validator

Series = Annotated[list[float], Field(min_length=1, max_length=100_000)]
Seeds = Annotated[list[Series], Field(min_length=1, max_length=10_000)]
"""Of each seed, one value an iteration."""
State = Annotated[list[float], Field(min_length=2, max_length=50)]


class _Data(Schema):
    """Figures may be NaN where there was nothing to measure."""

    model_config = ConfigDict(allow_inf_nan=True)


class Curve(_Data):
    """What the seeds of a method gave after so many samples."""

    samples: Series

    @model_validator(mode="after")
    def _as_long_as_each_other(self) -> Curve:
        for name, seeds in self:
            if name != "samples" and any(len(values) != len(self.samples) for values in seeds):
                raise ValueError(f"{name}: not one value for each of the samples")
        return self


class ValueCurve(Curve):
    """A curve of one figure."""

    values: Seeds


class SuccessCurve(Curve):
    """A curve of the success rate."""

    success: Seeds


class ReturnCurve(SuccessCurve):
    """A curve of success rate and return."""

    total: Seeds


class DrivenPath(_Data):
    """The states of an episode, and how it ended."""

    outcome: Name
    states: Annotated[list[State], Field(min_length=1, max_length=1_000_000)]

    @model_validator(mode="after")
    def _of_one_size(self) -> DrivenPath:
        if len({len(state) for state in self.states}) > 1:
            raise ValueError("states: of different sizes")
        return self


class Figures(_Data):
    """The figures' data of a results file; each package adds what it draws."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=True)

    task: Annotated[str, Field(pattern="^[a-z][a-z0-9_]*$", max_length=100)]
    task_digest: str | None = None
