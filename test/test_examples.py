"""Each script of examples/ runs, and prints or writes what it says; those that read a bag do so in test_demo.py."""

from pathlib import Path

import pytest
from commands import EXAMPLES, EXAMPLES_OF_A_BAG, check_example

OTHERS = {
    "time_to_reach_slice": ("from [0.0, -3.0, 1.0] it takes", "slice.png"),
    "reward_in_gymnasium": ("return so far",),
    "mpc_trajectory": ("ends at", "trajectory.png"),
    "own_system": ("from rest at 1.5 m: 2.36 s",),
    "ask_team_policy": ("running: nobody; chosen:",),
}
"""Words that it prints and file that it writes, by script."""


def test_each_example_is_run() -> None:
    assert {script.stem for script in EXAMPLES.glob("*.py")} == OTHERS.keys() | EXAMPLES_OF_A_BAG.keys()
    assert len(OTHERS) + len(EXAMPLES_OF_A_BAG) >= 6


@pytest.mark.parametrize("name", OTHERS)
def test_an_example_runs(name: str, tmp_path: Path) -> None:
    check_example(name, tmp_path, *OTHERS[name])
