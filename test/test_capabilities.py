"""What the table of capabilities says holds: a command starts on a task that it takes, and refuses others."""

import sys
from pathlib import Path

import pytest
from commands import command
from ctrl_rl_core.tasks import COMMANDS, can, unmet
from pages import ROOT

from ctrl_rl_core import load_navigation_task

sys.path.append(str(ROOT / "scripts" / "reference"))

from capabilities import MAP, TEAM, capability_page, examples, load

KINDS = ("arena, wheels", "arena, quadrotor", "corridor", "corridor, doorways", "jars or tools", MAP, TEAM)
CELLS = [(name, kind) for name in COMMANDS for kind in KINDS]
LINES = {
    "ctrl_rl_bringup demo": "demo --task {task} --policy no_such_policy --output {folder}/run",
    "ctrl_rl_bringup trials": "trials --task {task} --policy no_such_policy --output {folder}/run --seeds 1",
    "ctrl_rl_bringup record_drives": "record_drives --task {task} --episodes 1 --speed 8 --output {folder}/run",
    "ctrl_rl_bringup options_demo": "options_demo --team {task} --policy no_such_policy --output {folder}/run",
    "ctrl_rl_learning teach": "teach --task {task} --seeds 1 --samples 100 --folder {folder}",
    "ctrl_rl_learning fine_tune": "fine_tune no_such_policy --task {task} --minutes 0 --folder {folder}",
    "ctrl_rl_learning improve": "improve no_such_bag --task {task} --output {folder}/improved",
    "ctrl_rl_learning evaluate_offline": "evaluate_offline no_such_bag --task {task} --policy no_such_policy",
    "ctrl_rl_trials train": "train --tasks {task} --ways sparse --learners ppo --seeds 1 --samples 2048 "
    "--folder {folder}",
    "ctrl_rl_trials hardness": "hardness {task} --values {folder}",
    "ctrl_rl_trials loop": "loop --tasks {task} --seeds 1 --rounds 1 --episodes 5 --tests 1 --updates 5 --methods bc "
    "--folder {folder}",
    "ctrl_rl_trials correlation": "correlation --task {task} --seeds 1 --episodes 5 --tests 1 --updates 5 "
    "--folder {folder}",
    "koopman_lqr_controller edmd": "edmd no_such_bag --task {task} --output {folder}/policy.safetensors",
    "koopman_lqr_controller train": "train --task {task} --samples 100 --actions 100 --episodes 1 "
    "--consolidation 2 --folder {folder}",
    "oc_baseline_node oc data": "oc data {task} --trajectories 1 --output {folder}/data --workers 1",
    "oc_baseline_node train": "train --task {task} --methods ppo --seeds 1 --samples 2048 --folder {folder}",
    "option_coordinator train": "train --task {task} --seeds 1 --samples 1 --folder {folder}",
    "ttr_reward_node solve": "solve --task {task} --robot-size --output {folder}/value.safetensors",
    "ttr_reward_node train": "train --task {task} --rewards sparse --algorithms ppo --seeds 1 --samples 2048 "
    "--folder {folder}",
    "ttr_reward_node evaluate": "evaluate {policy} --task {task} --episodes 1",
}
"""Words after `ros2 run PACKAGE` that let a command begin with little to do."""
LINES |= {
    name: f"{name.split(' ', 1)[1].split()[0]} no_such_bag --task {{task}} --output {{folder}}/policy.safetensors "
    + name.partition("learn_offline ")[2]
    for name in COMMANDS
    if "learn_offline" in name
}
STARTED = ("no_such_", "must be at least", "observations are not those", "commands are not those", "pretrained")
"""Errors that come after the task has been taken: of the rest of a line that gives a command nothing to do."""


@pytest.fixture(scope="module")
def tasks(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return examples(tmp_path_factory.mktemp("tasks"))


def run(name: str, task: str, folder: Path) -> tuple[int, str]:
    """Run a command; return its exit code and what it said on stderr."""
    package, _, _ = name.partition(" ")
    policy = ROOT / "ctrl_rl_core/ctrl_rl_core/policies/pretrained/car_ttr.safetensors"
    executable, *words = LINES[name].format(task=task, folder=folder, policy=policy).split()
    answer = command(executable, *words, package=package)
    return answer.returncode, answer.stderr


def test_the_page_has_a_row_for_each_command_and_a_column_for_each_kind() -> None:
    page = capability_page()
    assert set(LINES) == set(COMMANDS)
    assert [line.split("|")[1].strip() for line in page.splitlines() if line.startswith("| `")][: len(COMMANDS)] == [
        f"`{name}`" for name in COMMANDS
    ]
    assert f"| command | {' | '.join(dict.fromkeys(KINDS))} |" in page


@pytest.mark.parametrize(("name", "kind"), CELLS)
def test_a_command_refuses_what_the_table_says(name: str, kind: str, tasks: dict[str, str], tmp_path: Path) -> None:
    reason = can(name, load(kind, tasks[kind]))
    if not reason:
        pytest.skip("the table says that it works")
    code, said = run(name, tasks[kind], tmp_path)
    assert code != 0
    (line,) = said.splitlines()
    # A team file is no task file: the readers of both say so in words of their own.
    assert reason in line or (kind == TEAM and "delivery_team" in line) or "no team" in line or "team_delivery" in line


@pytest.mark.parametrize(("name", "kind"), CELLS)
def test_a_part_that_the_table_names_is_all_that_a_task_lacks(name: str, kind: str, tasks: dict[str, str]) -> None:
    task = load(kind, tasks[kind])
    need = unmet(name, task)
    if need is None or not need.part:
        pytest.skip("the table names no part")
    whole = load_navigation_task("curved_corridor")
    assert can(name, task.model_copy(update={need.part: getattr(whole, need.part)})) == ""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), CELLS)
def test_a_command_starts_where_the_table_says(name: str, kind: str, tasks: dict[str, str], tmp_path: Path) -> None:
    if can(name, load(kind, tasks[kind])):
        pytest.skip("the table says that it refuses")
    code, said = run(name, tasks[kind], tmp_path)
    assert code == 0 or any(words in said for words in STARTED), said
