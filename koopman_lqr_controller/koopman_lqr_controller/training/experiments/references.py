"""Published returns of other learners, from `references.yaml`; as results rows for the page of results.

python -m koopman_lqr_controller.training.experiments.references FILE.json
"""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path
from typing import Annotated

from ctrl_rl_core.io import Name, Schema, read_yaml
from pydantic import Field, model_validator

from ctrl_rl_core import Result, write_results

_FILE = Path(__file__).with_suffix(".yaml")
_SHOWN = 100_000, 200_000, 350_000, 500_000
"""Numbers of frames in the table of results."""


class PublishedCurve(Schema):
    """Mean return and its sample standard deviation over the seeds after numbers of simulated frames."""

    seeds: Annotated[int, Field(ge=1)]
    frames: Annotated[list[int], Field(min_length=1)]
    mean: list[float]
    deviation: list[float]

    @model_validator(mode="after")
    def _check_lengths(self) -> PublishedCurve:
        if not len(self.frames) == len(self.mean) == len(self.deviation):
            raise ValueError("frames, mean and deviation: must have one length")
        return self

    def means(self, most: float = float("inf")) -> dict[int, float]:
        """Return the mean return by number of frames, up to a maximum number."""
        return {frames: mean for frames, mean in zip(self.frames, self.mean, strict=True) if frames <= most}


class Publication(Schema):
    """Published results of one learner, by task.

    Attributes:
        publication: Authors, year and title.
        data: Address of the data and path of the file.
        action_repeat: Number of simulated frames per action.
        updates_per_frame: Number of gradient steps per simulated frame; None if unknown.
        curves: Learning curves by task.
    """

    publication: Name
    data: Name
    action_repeat: Annotated[int, Field(ge=1)]
    updates_per_frame: float | None
    curves: dict[Name, PublishedCurve]


class _Content(Schema):
    references: dict[Name, Publication]


@cache
def publications() -> dict[str, Publication]:
    """Return all publications by the name of the learner."""
    return _Content.model_validate(read_yaml(_FILE)).references


def published_means(task: str, most: float) -> dict[str, dict[int, float]]:
    """Return the published mean returns on a task by learner and number of frames, up to a maximum number."""
    found = {name: each.curves[task].means(most) for name, each in publications().items() if task in each.curves}
    return {name: means for name, means in found.items() if means}


def main() -> int:
    """Write the published results as a results file."""
    sys.argv[0] = f"python -m {__spec__.name}"
    rows = [
        Result(f"{task}, {name}", f"return after {frames:,} frames", "1", [means[frames]])
        for name, each in publications().items()
        for task, curve in each.curves.items()
        for means in [curve.means()]
        for frames in _SHOWN
        if frames in means
    ]
    about = {name: each.model_dump(exclude={"curves"}) for name, each in publications().items()}
    write_results(Path(sys.argv[1]), "Published returns of other learners", [], rows, {"publications": about})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
