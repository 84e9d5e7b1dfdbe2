"""Advice is followed: what a command says is missing, done as it says, lets the same command end well."""

import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from commands import command
from ctrl_rl_learning.offline import ScriptedDriver, drive
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import LaserScan

from ctrl_rl_bags import BagWriter, open_bag
from ctrl_rl_core import load_navigation_task, task_file

NAVIGATION = "car_navigation"
EXPORT = "ctrl_rl_bags bag export {bag} --format lerobot --output {out}/set"
LEARN = (
    "ctrl_rl_learning learn_offline {bag} --task car_navigation --method bc --updates 5 --output {out}/p.safetensors"
)
TEAM = "option_coordinator train --bags {team} --folder {out} --evaluations 1"


def rewritten(source: Path, output: Path, change: Callable[[LaserScan, int], None], names: dict[str, str]) -> Path:
    """Copy a bag with its scans changed and its topics renamed."""
    with open_bag(source) as bag, BagWriter(output) as writer:
        for topic in bag.topics.values():
            writer.add_topic(replace(topic, name=names.get(topic.name, topic.name)))
        for number, message in enumerate(bag.messages()):
            data = message.data
            if message.topic == "/scan":
                scan = deserialize_message(data, LaserScan)
                change(scan, number)
                data = serialize_message(scan)
            writer.write(names.get(message.topic, message.topic), data, message.log_time)
        for key, text in bag.info.custom_data.items():
            writer.set_custom_data(key, text)
    return output


def ahead(scan: LaserScan, _number: int) -> None:
    scan.header.stamp.sec += 10


def wider_later(scan: LaserScan, number: int) -> None:
    if number > 100:
        scan.ranges = [*scan.ranges, 1.0, 1.0]
        scan.angle_max += 2 * scan.angle_increment


def same(_scan: LaserScan, _number: int) -> None:
    pass


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return bags of the same drives: as they are, and with what a robot may do differently."""
    folder = tmp_path_factory.mktemp("bags")
    task = load_navigation_task(NAVIGATION)
    drive(task, ScriptedDriver(task), 6, 1, folder / "bag")
    turned = {"/scan": "/front/scan", "/odom": "/wheels/odom", "/cmd_vel": "/nav/cmd_vel"}
    return {
        "bag": folder / "bag",
        "clocks": rewritten(folder / "bag", folder / "clocks", ahead, {}),
        "beams": rewritten(folder / "bag", folder / "beams", wider_later, {}),
        "renamed": rewritten(folder / "bag", folder / "renamed", same, turned),
    }


def own_task(file: Path, changes: dict[str, Any]) -> Path:
    """Write a task that differs from the one of the bags."""
    content = yaml.safe_load(task_file(NAVIGATION).read_text(encoding="utf-8"))
    file.write_text(yaml.safe_dump(content | changes, sort_keys=False), encoding="utf-8")
    return file


def run(words: str) -> tuple[int, str, str]:
    """Run a command; return its exit code, what it printed and the last line of its errors."""
    package, executable, *arguments = shlex.split(words)
    answer = command(executable, *arguments, package=package)
    return answer.returncode, answer.stdout, (answer.stderr.splitlines() or [""])[-1]


def refused(words: str, advice: str) -> re.Match[str]:
    """Check that a command is refused with some advice."""
    code, _, error = run(words)
    found = re.search(advice, error)
    assert code != 0, words
    assert found, error
    return found


def done(words: str) -> str:
    """Check that a command ends well; return what it printed."""
    code, said, error = run(words)
    assert code == 0, f"{words}: {error}"
    return said


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("words", "bag", "advice", "more"),
    [
        (EXPORT, "clocks", "--clock log", "--clock log"),
        (EXPORT, "beams", "--beams N", "--beams 8"),
        (EXPORT + " --period 0.1", "bag", r"take (0\.4) s or more, .* --period", "--period 0.4"),
        pytest.param(LEARN, "clocks", "--clock log", "--clock log", marks=SLOW),
        pytest.param(LEARN, "beams", "--beams N", "--beams 8", marks=SLOW),
        pytest.param(LEARN + " --task car_ttr", "bag", "--other-task", "--other-task", marks=SLOW),
    ],
)
def test_an_option_that_an_error_names_helps(
    words: str, bag: str, advice: str, more: str, bags: dict[str, Path], tmp_path: Path
) -> None:
    whole = words.format(bag=bags[bag], out=tmp_path)
    refused(whole, advice)
    done(f"{whole} {more}")


@pytest.mark.parametrize("words", [EXPORT, pytest.param(LEARN, marks=SLOW)])
def test_an_error_names_the_topics_that_a_bag_has_instead(words: str, bags: dict[str, Path], tmp_path: Path) -> None:
    whole = words.format(bag=bags["renamed"], out=tmp_path)
    _, _, error = run(whole)
    named = re.findall(r"--\w+ /[\w/]+", error)
    assert len(named) == 3, error
    done(" ".join((whole, *named)))


@pytest.mark.slow
def test_what_was_learnt_can_be_judged_as_it_says(bags: dict[str, Path], tmp_path: Path) -> None:
    task = own_task(tmp_path / "hall.yaml", {"name": "hall"})
    learn = LEARN.format(bag=bags["clocks"], out=tmp_path) + f" --task {task} --other-task --clock log"
    said = done(learn)
    refused(learn, "give another name, or --overwrite to replace it")
    assert done(f"{learn} --overwrite") == said
    (judge,) = re.findall(r"judge it +ros2 run (.*)", said)
    code, verdict, error = run(judge.replace("RUN ...", str(bags["clocks"])) + " --updates 5 --fits 1")
    assert "verdict" in verdict, error
    assert code in (0, 1)


@pytest.mark.slow
def test_bags_without_rewards_and_with_other_walls_are_learnt_from_in_the_end(
    bags: dict[str, Path], tmp_path: Path
) -> None:
    obstacles = yaml.safe_load(task_file(NAVIGATION).read_text(encoding="utf-8"))["obstacles"]
    obstacles[0]["box"]["centre"] = "(-0.4, 1.2) m"
    task = own_task(tmp_path / "moved.yaml", {"name": "moved", "obstacles": obstacles})
    task_of_map = tmp_path / "moved_map.yaml"
    learn = f"ctrl_rl_learning learn_offline {{bag}} --updates 5 --output {tmp_path}/p.safetensors"
    unlabelled = learn.format(bag=bags["bag"])
    refused(
        f"{unlabelled} --task {NAVIGATION} --method iql", "relabel --grid FILE` .* `ros2 run ttr_reward_node solve`"
    )
    value_model = f"{unlabelled} --task {task}"
    refused(value_model, "--other-task")
    refused(f"{value_model} --other-task", "--map-from-bag")
    assert f"pass --task {task_of_map} --other-task" in done(f"{value_model} --other-task --map-from-bag")
    advice = refused(
        f"{value_model} --other-task --map-from-bag --method iql --overwrite",
        r"relabel the bags for the map's task moved_map and learn with (--task .*)",
    )
    done(f"ttr_reward_node solve --task {task_of_map} --robot-size --output {tmp_path}/value.safetensors")
    labelled = f"ttr_reward_node relabel {bags['bag']} {tmp_path}/labelled --grid {tmp_path}/value.safetensors"
    refused(f"{labelled} --task {task_of_map}", "--other-task")
    done(f"{labelled} --task {task_of_map} --other-task")
    done(learn.format(bag=tmp_path / "labelled") + f" --method iql --overwrite {advice.group(1)}")


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bag of a team's script."""
    folder = tmp_path_factory.mktemp("team")
    done(f"option_coordinator loop --folder {folder} --seeds 1 --rounds 1 --episodes 10 --tests 1")
    return folder / "tool_delivery-s0" / "round_0" / "bag"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "advice", "more"),
    [
        (TEAM, "or a --task", "--task tool_delivery"),
        (TEAM + " --task tool_delivery --way mappo", "try --way weighted", "--way weighted"),
    ],
)
def test_a_team_learns_from_bags_as_it_is_told(words: str, advice: str, more: str, team: Path, tmp_path: Path) -> None:
    whole = words.format(team=team, out=tmp_path)
    refused(whole, advice)
    done(f"{whole} {more}")
