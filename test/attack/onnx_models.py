"""ONNX models of others: a policy that drives, or one line, in bounded time and memory."""

from __future__ import annotations

import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import yaml
from _attack import Attack
from _mutations import cut, flip, overwrite

from ctrl_rl_core import PolicyError, load_policy

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "ctrl_rl_core" / "test"))
_LONGEST_S = 40.0


def run(random: np.random.Generator, folder: Path) -> None:
    """Load models that were mutated, and one that is hostile; nothing without onnx and onnxruntime."""
    if not (find_spec("onnx") and find_spec("onnxruntime")):
        return
    from policy_files import DRIVE
    from test_policies import hostile_model, onnx_file

    file = onnx_file(folder)
    whole = file.read_bytes()
    broken = [(flip, cut, overwrite)[int(random.integers(3))](whole, random) for _ in range(4)]
    for content in (*broken, hostile_model(str(random.choice(["endless", "large", "elsewhere"])))):
        file.write_bytes(content)
        file.with_suffix(".yaml").write_text(yaml.safe_dump(DRIVE))
        began = time.monotonic()
        try:
            load_policy(file)
        except PolicyError as error:
            said = str(error)
        else:
            said = ""
        assert not said or said.isprintable(), f"{said!r}"
        assert time.monotonic() - began < _LONGEST_S, "a model took too long to load"


ATTACKS = (
    Attack("onnx", "A model of anybody drives, or is refused in one line in bounded time and memory.", run, 600.0),
)
