"""Some broken files of every kind; `make attack` goes on with other seeds."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent / "attack"))

from _mutations import change_tensors
from files import KINDS, attack, check


@pytest.mark.fault
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_broken_file_is_loaded_or_refused_in_one_line(tmp_path: Path, kind) -> None:
    attack(kind, 5 if "figures" in kind.name else 40)(np.random.default_rng(0), tmp_path)


@pytest.mark.fault
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.how is change_tensors], ids=lambda kind: kind.name)
def test_every_flipped_bit_in_the_tensors_is_refused(tmp_path: Path, kind) -> None:
    random = np.random.default_rng(0)
    for path in kind.make(tmp_path):
        whole = path.read_bytes()
        begin = 8 + int.from_bytes(whole[:8], "little")
        for place in random.integers(begin, len(whole), 50):
            damaged = bytearray(whole)
            damaged[place] ^= 1 << int(random.integers(8))
            assert "does not match its digest" in check(kind, path, bytes(damaged))
        path.write_bytes(whole)
        assert not check(kind, path, whole)
