"""Some broken files of every kind; `make attack` goes on with other seeds."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent / "attack"))

from files import KINDS, attack


@pytest.mark.fault
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_broken_file_is_loaded_or_refused_in_one_line(tmp_path: Path, kind) -> None:
    attack(kind, 5 if "figures" in kind.name else 40)(np.random.default_rng(0), tmp_path)
