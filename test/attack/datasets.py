"""Broken datasets: what `bag import` takes gives bags that can be read, and all else is one line, in bounded memory."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
from _attack import Attack
from _limited import run_limited
from _mutations import cut, flip, overwrite
from clocks import COMMANDS, SENSORS, _message
from ctrl_rl_bags.datasets import ExtractionOptions, MessageMaker, export_bags

from ctrl_rl_bags import BagWriter

_IMPORT = "import sys; from ctrl_rl_bags.cli import main; sys.exit(main(sys.argv[1:]))"
_MEMORY = 4_000_000_000
_LIMIT_S = 60


def run(random: np.random.Generator, folder: Path) -> None:
    """Export a drive in both formats, break a file of each a few times, and import it."""
    make = MessageMaker()
    with BagWriter(folder / "bag") as bag:
        for name, kind in (*SENSORS, ("/cmd_vel", COMMANDS[1])):
            bag.add_topic(make.topic(name, kind))
            for k in range(20):
                time = (k + 1) * 10**8
                bag.write(name, _message(make, name, COMMANDS[1], time, k), time)
    for kind in ("lerobot", "minari"):
        export_bags([folder / "bag"], folder / kind, kind, ExtractionOptions())
        files = sorted(path for path in (folder / kind).rglob("*") if path.is_file())
        for _ in range(4):
            file = files[int(random.integers(len(files)))]
            whole = file.read_bytes()
            if random.random() < 0.15:
                file.unlink()
                os.mkfifo(file)
            else:
                file.write_bytes((flip, cut, overwrite)[int(random.integers(3))](whole, random))
            _import(folder / kind, folder / "bags")
            file.unlink()
            file.write_bytes(whole)


def _import(dataset: Path, output: Path) -> None:
    words = ("-c", _IMPORT, "import", dataset, "-o", output)
    if run_limited("import", words, _MEMORY, _LIMIT_S).returncode == 1:
        assert not output.exists(), "import left half a folder"
    shutil.rmtree(output, ignore_errors=True)


ATTACKS = (
    Attack("datasets", "A dataset is read as it was written or refused in one line, without waiting.", run, 600.0),
)
