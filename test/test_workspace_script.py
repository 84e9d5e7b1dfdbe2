"""The `ros2 run` of scripts/workspace.bash, where no ROS is installed."""

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
HEAD = f"set -e; . '{ROOT}/scripts/workspace.bash'; [[ $(type -t ros2) == function ]] || exit 77\n"


def shell(script: str) -> str:
    """Run a script in a shell with the workspace and return what it printed."""
    answer = subprocess.run(
        ["bash", "-c", HEAD + script], capture_output=True, text=True, env=os.environ, timeout=120, check=False
    )
    if answer.returncode == 77:
        pytest.skip("a ROS is installed")
    assert answer.returncode == 0, answer.stderr
    return answer.stdout


def test_who_ends_a_node_in_the_background_ends_the_node_in_good_order(tmp_path: Path) -> None:
    out = shell(f"""
        ros2 run sim_bridge bridge > {tmp_path}/log 2>&1 & shell=$!
        until grep -q robot {tmp_path}/log; do sleep 0.05; done
        node=$(pgrep -P $shell)
        kill $shell
        wait $shell; echo code $?
        kill -0 $node 2>/dev/null && echo alive || echo gone
    """)
    assert out.splitlines() == ["code 0", "gone"]


def test_exit_codes_input_and_output_pass_through_a_pipe() -> None:
    out = shell("""
        ros2 run ctrl_rl_bags bag --help | head -1
        set +e
        (ros2 run ctrl_rl_bags bag nonsense; echo code $?; echo second) 2>/dev/null
    """)
    assert out.startswith("usage: ")
    assert out.splitlines()[-2:] == ["code 2", "second"]
