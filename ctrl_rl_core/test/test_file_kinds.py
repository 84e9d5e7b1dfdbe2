"""A file given to the wrong reader is identified in the error message."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_core.io.checked_tensors import KINDS, read_tensors
from ctrl_rl_core.io.file_checks import FileError
from safetensors.numpy import save_file

ROOT = Path(__file__).parents[2]


def test_a_network_given_to_the_controller_is_named_and_what_takes_it(tmp_path: Path) -> None:
    file = tmp_path / "network.safetensors"
    save_file({"weight_0": np.zeros((2, 2), np.float32)}, file, {"actor": json.dumps({"format": "actor-1"})})
    with pytest.raises(FileError, match=r"is an actor-1 network .*policy \(policy:=FILE\); wanted is a Koopman"):
        read_tensors(file, "policy")


def test_every_kind_of_file_that_the_suite_writes_is_known() -> None:
    files = [file for package in ROOT.glob("*/package.xml") for file in package.parent.glob("*/**/*.py")]
    keys = {key for file in files for key in re.findall(r'^_?HEADER_KEY = "(\w+)"', file.read_text(), re.MULTILINE)}
    assert len(keys) > 4
    assert keys <= set(KINDS)
