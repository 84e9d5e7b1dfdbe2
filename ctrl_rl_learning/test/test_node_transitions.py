"""Transitions of real nodes beside the policy in process: simulator, policy, watchdog and recorder at three speeds."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from commands import command
from ctrl_rl_bags.datasets import TaskDriveOptions
from ctrl_rl_learning.offline import actions_of, load_transitions

from ctrl_rl_core import Actor, find_policy, load_navigation_task, task_file

pytestmark = [pytest.mark.realtime, pytest.mark.slow]


@pytest.mark.parametrize("speed", [1.0, 4.0, 0.05])
def test_each_frame_has_the_command_that_answered_its_scan(tmp_path: Path, speed: float) -> None:
    """The policy says in process what it commanded at each frame; who missed a scan held the command before."""
    content = yaml.safe_load(task_file("corridor_doorways").read_text())
    content |= {"corridor": content["corridor"] | {"pieces": [{"straight": "1.5 m"}]}, "goal": {"s": "1.1 .. 1.4 m"}}
    file = tmp_path / "corridor_doorways.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    words = ("--task", file, "--policy", "corridor_doorways", "--speed", speed, "--output", tmp_path / "run")
    answer = command("demo", *words)
    assert answer.returncode == 0, answer.stdout + answer.stderr

    actor = Actor.load(find_policy("corridor_doorways"))
    bag, told = tmp_path / "run" / "bag", list[str]()
    transitions = load_transitions(
        [bag], load_navigation_task(file), TaskDriveOptions(), actor.interface, tell=told.append
    )
    own = actions_of(actor, transitions.observations)
    answered = np.isclose(transitions.actions, own, atol=1e-4).all(axis=1)
    held = np.zeros_like(answered)
    held[1:] = np.isclose(transitions.actions[1:], transitions.actions[:-1], atol=1e-6).all(axis=1)
    assert len(transitions) >= 15
    assert (answered | held).all(), np.column_stack((transitions.actions, own))[~(answered | held)]
    assert answered.mean() >= 0.9
    assert np.abs(np.diff(own[:, 1])).max() > 0.01, "commands that never change would show nothing"
    assert transitions.success == 1.0
    assert told == []
