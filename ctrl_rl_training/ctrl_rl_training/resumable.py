"""Learning in iterations that may be cut off at any time, whatever it is that learns."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Protocol

from ctrl_rl_core.whole_file import write_whole

from ctrl_rl_training.errors import TrainingError
from ctrl_rl_training.run_folder import Named, check_same, read_result, result_file

Point = dict[str, Any]
"""What a curve says of an iteration, as JSON."""


class Learning(Protocol):
    """What learns, between two iterations."""

    def iterate(self, curve: Sequence[Point], /) -> Point:
        """Learn for one iteration more than the curve has and return what to say about it."""

    def save(self, path: Path, progress: Mapping[str, Any], /) -> None:
        """Write a checkpoint; `progress` is JSON that belongs to it."""

    def load(self, path: Path, /) -> dict[str, Any]:
        """Go on from a checkpoint and return its `progress`."""

    def finish(self, folder: Path, /) -> dict[str, Any]:
        """Write what was learnt into the run's folder and return what the result says of it, as JSON."""


def resumable(
    run: Named,
    folder: Path,
    iterations: int,
    terms: Mapping[str, Any],
    begin: Callable[[], AbstractContextManager[Learning]],
    report: Callable[[int, Point], None],
) -> dict[str, Any]:
    """Learn, or go on where an earlier call was cut off; a finished run is read, never computed again.

    A finished run keeps no checkpoint, which with a replay is large: it cannot be made longer.

    Args:
        run: what is learnt.
        folder: where each run has a folder of its own.
        iterations: how many; a run that was cut off may go on to more of them.
        terms: what must be the same for a run to go on, or to be taken as it is.
        begin: returns what learns, as it is before the first iteration; closed at the end.
        report: called after each iteration with how many are done.

    Returns:
        `run` (the terms), `curve` (what each iteration said, and its `seconds`) and what `Learning.finish` said.

    Raises:
        TrainingError: the folder holds another run, one of other iterations, or something damaged.
        CtrlRlError: what learns refuses.
    """
    finished = result_file(folder, run)
    if finished.is_file():
        result = read_result(finished)
        check_same(finished, result["run"], terms)
        done = len(result["curve"])
        if done != iterations:
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
            progress = learning.load(checkpoint)
            check_same(checkpoint, progress["run"], terms)
            curve = progress["curve"]
            if len(curve) > iterations:
                raise TrainingError(
                    f"{checkpoint}: has {len(curve)} iterations already: ask for no fewer, or delete it to begin anew"
                )
        while len(curve) < iterations:
            start = time.perf_counter()
            point = learning.iterate(curve)
            curve.append({**point, "seconds": round(time.perf_counter() - start, 2)})
            learning.save(checkpoint, {"run": terms, "curve": curve})
            report(len(curve), point)
        result = {"run": dict(terms), "curve": curve, **learning.finish(finished.parent)}
    write_whole(finished, json.dumps(result) + "\n")
    checkpoint.unlink(missing_ok=True)
    return result
