"""The training loop of every method: it keeps checkpoints and may be cut off at any time.

result = train(run, RunOptions(Path("runs/mine"), iterations=10, samples=10240))

An iteration draws its random numbers from the seed and its own number, so that a run that goes on from its last
checkpoint ends exactly as if it had not been cut off.
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
"""Errors of a checkpoint that is damaged, or belongs to another learner."""
AnyRun = TypeVar("AnyRun", bound=Run)
Report = Callable[[AnyRun, int, float | str], None]
"""Takes a run and, like `run.ProgressCallback`, how far it is."""


def train(run: AnyRun, options: RunOptions, report: Report[AnyRun] = lambda *_: None) -> dict[str, Any]:
    """Learn, or go on where an earlier call was cut off; read a finished run instead of learning it again.

    The folder of the run then holds result.json, which is returned, its curves (see `curves`), and what
    `Trainer.finish` writes. A finished run
    keeps no checkpoint, which is large with a replay: it cannot be made longer.

    Args:
        run: Run to learn.
        options: Settings of the experiment.
        report: Function that is called after each iteration, and where a run goes on.

    Returns:
        `run` (its fingerprint), `curve` (figures of each iteration, with `seconds` and `cpu_seconds`), the figures that
        `Trainer.finish` returned, and `cpu_seconds` of all of it.

    Raises:
        LearningError: The folder holds another run, one of other iterations, or something damaged.
        CtrlRlError: The learner refuses.
    """
    import torch  # takes seconds: not before a command's options are right

    torch.set_num_threads(1)
    terms = json.loads(json.dumps(run.fingerprint(options)))
    finished = result_file(options.folder, run)
    if finished.is_file():
        result = read_result(finished)
        check_same(finished, result["run"], terms)
        done = len(result["curve"])
        if done != options.iterations and "iterations" not in terms:
            raise LearningError(
                f"{finished}: is finished with {done} iterations and kept no checkpoint: ask for {done} again, or use "
                f"another folder or delete {finished.parent} to learn {options.iterations} from the start"
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
                    f"{checkpoint}: has {len(curve)} iterations already: ask for no fewer, or delete it to begin anew"
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
    with raise_as(LearningError, checkpoint, "cannot go on from it, delete it to begin anew"):
        try:
            return Progress.model_validate(learning.load(checkpoint))
        except (ValidationError, OSError):
            raise
        except UNUSABLE as error:
            raise LearningError(f"is of another learner ({type(error).__name__}: {error})") from None
