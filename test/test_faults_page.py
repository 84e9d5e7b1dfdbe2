"""The page of faults names tests and attacks that exist."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "faults.md").read_text(encoding="utf-8")
NAMED = sorted(set(re.findall(r"`([\w/]+\.py)(?:::(\w+))?`", PAGE)))


def test_every_fault_has_a_test():
    rows = [line for line in PAGE.splitlines() if line.startswith("| ") and not line.startswith("| fault")]
    assert len(rows) > 60
    assert all(".py" in row for row in rows)


@pytest.mark.parametrize(("file", "name"), NAMED)
def test_a_named_test_exists(file: str, name: str):
    assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8") if name else (ROOT / file).is_file()


def test_named_attacks_exist():
    answer = subprocess.run(
        [sys.executable, ROOT / "test" / "attack", "--list"], capture_output=True, text=True, check=True
    )
    attacks = {line.split()[0] for line in answer.stdout.splitlines()}
    named = set(re.findall(r"`make attack`: ([\w-]+)", PAGE))
    assert named <= attacks | {attack.split("-")[0] for attack in attacks}
    assert {attack.split("-")[0] for attack in attacks} <= {name.split("-")[0] for name in named} | {"fault"}
