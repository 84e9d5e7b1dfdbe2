"""The command `teach`: train a lidar policy for corridors from an expert that drives by the time to reach."""

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
    """Train policies to drive a corridor by lidar alone, resuming an interrupted call.

    The expert knows walls and partitions and drives by the time to reach. The student observes a scan and its speeds;
    it drives, and at each scan learns the command that the expert would give. Each episode draws a new corridor, and a
    new robot if the task gives ranges. Training uses the planar engine; `ros2 run ctrl_rl_bringup transfer` tests the
    policies in PyBullet and MuJoCo.
    """

    task: str = "corridor_doorways"
    """Task with a corridor: one of the suite, or a task file."""
    folder: FolderToWrite = Path("runs/teach")
    """Folder of the runs; each run has its own subfolder and resumes there."""
    clutter: bool = False
    """Draw corridors as the file says in a quarter of the episodes, and with legs, openings or both in the others."""
    seeds: Positive = 3
    """Number of seeds, starting from 0."""
    samples: Positive = 8 * _ITERATION
    """Minimum number of scans that a run learns from, rounded up to iterations of 4000."""
    results: OptionalFileToWrite = None
    """JSON file to write the table and curves to."""


def _teach(options: Teach) -> int:
    task = load_navigation_task(options.task)
    require("ctrl_rl_learning teach", task)
    # Torch takes seconds to import: wait until the arguments are valid.
    from ctrl_rl_learning.dagger.clutter import KINDS
    from ctrl_rl_learning.dagger.run import TaughtRun, collect

    runs = [TaughtRun(options.task, seed, options.clutter) for seed in range(options.seeds)]
    evaluations = _FINAL_EVALUATIONS * (len(KINDS) if options.clutter else 1)
    how = RunOptions(options.folder, math.ceil(options.samples / _ITERATION), _ITERATION, 0, evaluations)
    train_and_collect(options, task, runs, "teaching", collect, how)
    return 0


teach = make_command("teach", Teach, _teach)
