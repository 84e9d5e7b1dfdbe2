"""Learning in iterations that may be cut off at any time, whatever it is that learns."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Protocol

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.io.atomic_write import atomic_write
from ctrl_rl_core.io.checked_json import with_digest
from ctrl_rl_core.io.file_checks import raise_as
from pydantic import ValidationError

from ctrl_rl_training.errors import TrainingError
from ctrl_rl_training.experiments.run_folder import Named, Progress, check_same, read_result, result_file

UNUSABLE = (OSError, CtrlRlError, ValueError, LookupError, RuntimeError, TypeError, AttributeError)
"""What goes wrong with a checkpoint that is damaged, or of another learner."""
Point = dict[str, Any]
"""What a curve says of an iteration, as JSON."""


class Learning(Protocol):
    """What learns, between two iterations."""

    def iterate(self, curve: Sequence[Point], /) -> Point:
        """Learn for one iteration more than the curve has and return what to say about it."""

    def save(self, path: Path, progress: Mapping[str, Any], /) -> None:
        """Write a checkpoint; `progress` is JSON that belongs to it."""

    def load(self, path: Path, /) -> dict[str, Any]:
        """Go on from a checkpoint and return its `progress`.

        Raises:
            Exception: one of `UNUSABLE`, if the file cannot be read or is of something else.
        """

    def finish(self, folder: Path, /) -> dict[str, Any]:
        """Write what was learnt into the run's folder and return what the result says of it, as JSON."""


def resumable(
    run: Named,
    folder: Path,
    iterations: int,
    terms: Mapping[str, Any],
    begin: Callable[[], AbstractContextManager[Learning]],
    report: Callable[[int, Point], None],
    over: Callable[[Sequence[Point]], bool] = lambda _: False,
) -> dict[str, Any]:
    """Learn, or go on where an earlier call was cut off; a finished run is read, never computed again.

    A finished run keeps no checkpoint, which with a replay is large: it cannot be made longer.

    Args:
        run: what is learnt.
        folder: where each run has a folder of its own.
        iterations: how many, at most; a run that was cut off may go on to more of them.
        terms: what must be the same for a run to go on, or to be taken as it is; where a run may end before its
            iterations do, they name these too.
        begin: returns what learns, as it is before the first iteration; closed at the end.
        report: called after each iteration with how many are done.
        over: whether learning ends early, after the iterations of a curve.

    Returns:
        `run` (the terms), `curve` (what each iteration said, and its `seconds` and `cpu_seconds`), what
        `Learning.finish` said, and `cpu_seconds` of all of it.

    Raises:
        TrainingError: the folder holds another run, one of other iterations, or something damaged.
        CtrlRlError: what learns refuses.
    """
    finished = result_file(folder, run)
    if finished.is_file():
        result = read_result(finished)
        check_same(finished, result["run"], terms)
        done = len(result["curve"])
        if done != iterations and "iterations" not in terms:
            raise TrainingError(
                f"{finished}: is finished with {done} iterations and kept no checkpoint: ask for {done} again, or use "
                f"another folder or delete {finished.parent} to learn {iterations} from the start"
            )
        return result
    checkpoint = finished.with_name("checkpoint.safetensors")
    checkpoint.parent.mkdir(parents=True, exist_ok=True)
    with begin() as learning:
        curve: list[Point] = []
        if checkpoint.is_file():
            progress = _load(learning, checkpoint)
            check_same(checkpoint, progress.run, terms)
            curve = progress.curve
            if len(curve) > iterations:
                raise TrainingError(
                    f"{checkpoint}: has {len(curve)} iterations already: ask for no fewer, or delete it to begin anew"
                )
        while len(curve) < iterations and not over(curve):
            start, cpu = time.perf_counter(), time.process_time()
            point = learning.iterate(curve)
            took = {"seconds": time.perf_counter() - start, "cpu_seconds": time.process_time() - cpu}
            curve.append({**point, **{name: round(each, 2) for name, each in took.items()}})
            learning.save(checkpoint, {"run": terms, "curve": curve})
            report(len(curve), point)
        cpu = time.process_time()
        result = {"run": dict(terms), "curve": curve, **learning.finish(finished.parent)}
        finishing = time.process_time() - cpu
        result["cpu_seconds"] = round(sum(point.get("cpu_seconds", 0.0) for point in curve) + finishing, 2)
    atomic_write(finished, json.dumps(with_digest(result)) + "\n")
    checkpoint.unlink(missing_ok=True)
    return result


def _load(learning: Learning, checkpoint: Path) -> Progress:
    with raise_as(TrainingError, checkpoint, "cannot go on from it, delete it to begin anew"):
        try:
            return Progress.model_validate(learning.load(checkpoint))
        except (ValidationError, OSError):
            raise
        except UNUSABLE as error:
            raise TrainingError(f"is of another learner ({type(error).__name__}: {error})") from None
