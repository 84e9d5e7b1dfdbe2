"""The training loop of every method, with checkpoints, interruptible at any time.

result = train(run, RunOptions(Path("runs/mine"), iterations=10, samples=10240))

An iteration draws its random numbers from the seed and its own number, so that a run resumed from its last
checkpoint ends exactly as if it had not been interrupted.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from ctrl_rl_core.io import raise_as, with_digest
from pydantic import ValidationError

from ctrl_rl_core import CtrlRlError, atomic_write
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.study.curves import Curves
from ctrl_rl_learning.study.run import Progress, Run, RunOptions, Trainer, check_same, read_result, result_file

UNUSABLE = (OSError, CtrlRlError, ValueError, LookupError, RuntimeError, TypeError, AttributeError)
"""Exceptions that a damaged checkpoint, or one of another learner, may raise."""
AnyRun = TypeVar("AnyRun", bound=Run)
Report = Callable[[AnyRun, int, float | str], None]
"""Called with a run and its progress, as in `run.ProgressCallback`."""


def train(run: AnyRun, options: RunOptions, report: Report[AnyRun] = lambda *_: None) -> dict[str, Any]:
    """Train a run, resuming an interrupted one; a finished run is read, not trained again.

    The run's folder then holds result.json (the returned content), the curves (see `curves`) and the files that
    `Trainer.finish` writes. A finished run cannot be extended: it keeps no checkpoint, which a replay buffer would make
    large.

    Args:
        run: Run to train.
        options: Settings of the experiment.
        report: Called after each iteration, and when a run is resumed.

    Returns:
        `run` (its fingerprint), `curve` (figures of each iteration, with `seconds` and `cpu_seconds`), the figures from
        `Trainer.finish`, and the total `cpu_seconds`.

    Raises:
        LearningError: The folder holds another run, a different number of iterations, or a damaged file.
        CtrlRlError: The learner fails.
    """
    import torch  # takes seconds: wait until the command's options are valid

    torch.set_num_threads(1)
    terms = json.loads(json.dumps(run.fingerprint(options)))
    finished = result_file(options.folder, run)
    if finished.is_file():
        result = read_result(finished)
        check_same(finished, result["run"], terms)
        done = len(result["curve"])
        if done != options.iterations and "iterations" not in terms:
            raise LearningError(
                f"{finished}: finished with {done} iterations and kept no checkpoint: ask for {done} again, or use "
                f"another folder or delete {finished.parent} to train {options.iterations} from the start"
            )
    else:
        result = _learn(run, options, terms, finished, report)
    run.check(finished.parent, result)
    return result


def _learn(
    run: AnyRun, options: RunOptions, terms: dict[str, Any], finished: Path, report: Report[AnyRun]
) -> dict[str, Any]:
    checkpoint = finished.with_name("checkpoint.safetensors")
    checkpoint.parent.mkdir(parents=True, exist_ok=True)
    with run.begin(options, lambda done, how: report(run, done, how)) as learning:
        curve: list[dict[str, Any]] = []
        if checkpoint.is_file():
            progress = _load(learning, checkpoint)
            check_same(checkpoint, progress.run, terms)
            curve = progress.curve
            if len(curve) > options.iterations:
                raise LearningError(
                    f"{checkpoint}: already has {len(curve)} iterations: ask for no fewer, or delete it to start over"
                )
            report(run, len(curve), run.words(curve[-1]))
        with Curves(finished.parent, curve) as curves:
            while len(curve) < options.iterations and not run.should_stop(curve):
                start, cpu = time.perf_counter(), time.process_time()
                point = learning.iterate(curve)
                took = {"seconds": time.perf_counter() - start, "cpu_seconds": time.process_time() - cpu}
                curve.append({**point, **{name: round(each, 2) for name, each in took.items()}})
                learning.save(checkpoint, {"run": terms, "curve": curve})
                curves.add(curve[-1])
                report(run, len(curve), run.words(point))
        cpu = time.process_time()
        result = {"run": terms, "curve": curve, **learning.finish(finished.parent)}
        finishing = time.process_time() - cpu
        result["cpu_seconds"] = round(sum(point.get("cpu_seconds", 0.0) for point in curve) + finishing, 2)
    atomic_write(finished, json.dumps(with_digest(result)) + "\n")
    checkpoint.unlink(missing_ok=True)
    return result


def _load(learning: Trainer, checkpoint: Path) -> Progress:
    with raise_as(LearningError, checkpoint, "cannot resume from it: delete it to start over"):
        try:
            return Progress.model_validate(learning.load(checkpoint))
        except (ValidationError, OSError):
            raise
        except UNUSABLE as error:
            raise LearningError(f"belongs to another learner ({type(error).__name__}: {error})") from None
