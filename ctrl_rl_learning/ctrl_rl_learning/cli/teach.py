"""The command `teach`: a lidar policy for corridors, taught by the time to reach on the true map of each episode."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from ctrl_rl_core.command import FolderToWrite, OptionalFileToWrite
from ctrl_rl_core.tasks import require

from ctrl_rl_core import load_navigation_task
from ctrl_rl_learning.study.command import ExperimentOptions, Positive, make_command, train_and_collect
from ctrl_rl_learning.study.run import RunOptions

_ITERATION = 4000
_FINAL_EVALUATIONS = 40


@dataclass(frozen=True, kw_only=True)
class Teach(ExperimentOptions):
    """Teach policies to drive a corridor by lidar alone, and go on where an earlier call was cut off.

    The expert knows walls and partitions and drives by the time to reach. The student sees a scan and its speeds; it
    drives, and learns at each scan what the expert would do there. Each episode has another corridor, and another
    robot where the task gives ranges. It is learnt in the planar engine: `ros2 run ctrl_rl_bringup transfer` drives the
    policies in PyBullet and MuJoCo.
    """

    task: str = "corridor_doorways"
    """Task with a corridor: one of the suite, or a task file."""
    folder: FolderToWrite = Path("runs/teach")
    """Folder of the runs; each has one of its own, and goes on there where it was cut off."""
    seeds: Positive = 3
    """Number of seeds, counted from 0."""
    samples: Positive = 8 * _ITERATION
    """Scans that a run learns from, at least; whole iterations of 4000 are driven."""
    results: OptionalFileToWrite = None
    """JSON file to write table and curves to."""


def _teach(options: Teach) -> int:
    task = load_navigation_task(options.task)
    require("ctrl_rl_learning teach", task)
    # Torch takes seconds to import: not before the arguments are right.
    from ctrl_rl_learning.dagger.run import TaughtRun, collect

    runs = [TaughtRun(options.task, seed) for seed in range(options.seeds)]
    how = RunOptions(options.folder, math.ceil(options.samples / _ITERATION), _ITERATION, 0, _FINAL_EVALUATIONS)
    train_and_collect(options, task, runs, "teaching", collect, how)
    return 0


teach = make_command("teach", Teach, _teach)
