"""Each script of examples/ runs, and prints or writes what it says."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from commands import command

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
ARGUMENTS = {
    "time_to_reach_slice": ("slice.png",),
    "mpc_trajectory": ("trajectory.png",),
    "align_bag": ("{bag}",),
    "koopman_policy_from_bag": ("{bag}", "policy.safetensors"),
}
"""Arguments by script; what ends on a suffix is written by it."""
SAYS = {
    "time_to_reach_slice": "from [0.0, -3.0, 1.0] it takes",
    "reward_in_gymnasium": "return so far",
    "mpc_trajectory": "ends at",
    "own_system": "from rest at 1.5 m: 2.4",
    "align_bag": "sequence 0:",
    "koopman_policy_from_bag": "slowest poles",
    "ask_team_policy": "running: nobody; chosen:",
}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drives") / "run"
    answer = command("record_drives", "--episodes", 2, "--speed", 8, "--output", folder)
    assert answer.returncode == 0, answer.stderr
    return folder / "bag"


def test_each_example_is_run() -> None:
    assert {script.stem for script in EXAMPLES.glob("*.py")} == SAYS.keys()
    assert len(SAYS) >= 6


@pytest.mark.parametrize("name", SAYS)
def test_an_example_runs(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    arguments = ARGUMENTS.get(name, ())
    if "{bag}" in arguments:
        drives = request.getfixturevalue("bag")
        arguments = tuple(argument.format(bag=drives) for argument in arguments)
    answer = subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py", *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        env=os.environ,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    assert SAYS[name] in answer.stdout
    for written in (argument for argument in arguments if argument.endswith((".png", ".safetensors"))):
        assert (tmp_path / written).stat().st_size > 1000
