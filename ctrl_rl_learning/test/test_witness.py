"""Bags as witnesses against a task's file: moved walls are told, true worlds are not refused, maps come from scans."""

import math
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from ctrl_rl_bags.datasets import TaskDriveOptions
from ctrl_rl_learning.cli.evaluate_offline import evaluate_offline
from ctrl_rl_learning.cli.learn_offline import learn_offline
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.data.transitions import load_transitions, read_drives
from ctrl_rl_learning.offline.driving.drivers import ScriptedDriver
from ctrl_rl_learning.offline.driving.driving import drive
from ctrl_rl_learning.offline.learners.learning import learn_from_drives
from ctrl_rl_learning.offline.witness import (
    Account,
    DriveRecord,
    Witness,
    draw_account,
    examine,
    map_from_record,
    task_with_map,
)
from ctrl_rl_learning.offline.witness.map_rays import map_ranges
from ctrl_rl_learning.offline.witness.offset import Offset
from sim_bridge.engines import shape_row
from sim_bridge.fleet import scans

from ctrl_rl_core import Actor, Interval, NavigationTask, OccupancyMap, load_navigation_task, task_digest, task_file

Box = tuple[float, float, float, float]
"""Centre and size of a box [m]."""
BOXES: tuple[Box, ...] = ((-0.8, 0.7, 0.5, 0.5), (0.9, -0.6, 0.5, 0.5), (0.6, 1.1, 0.4, 0.4))
EPISODES = 5


def room(folder: Path, boxes: Sequence[Box] = BOXES, **changes) -> NavigationTask:
    """Write and load a room of 6 m x 4 m with boxes, a burger and 120 beams; named the same wherever it lies."""
    content = yaml.safe_load(task_file("walkers").read_text()) | {"name": "room", "about": "A room.", **changes}
    if "movers" not in changes:
        del content["movers"]
    content["episode"] = {"steps": 150, "time_step": "0.2 s"}
    content["lidar"]["beams"] = 120
    content["obstacles"] = [
        {"box": {"centre": f"({x:.3f}, {y:.3f}) m", "size": f"({wide:.3f}, {high:.3f}) m"}}
        for x, y, wide, high in boxes
    ]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "room.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return load_navigation_task(folder / "room.yaml")


def record(task: NavigationTask, bag: Path, episodes: int = 5, seed: int = 0) -> DriveRecord:
    """Record episodes in a task's world, and return what they saw."""
    drive(task, ScriptedDriver(task), episodes, seed, bag)
    witness = Witness(task)
    load_transitions([bag], task, TaskDriveOptions(), witness=witness)
    return witness.record()


def mistaken(seen: DriveRecord, place: float, heading: float, seed: int = 0, keeps: float = 0.95) -> DriveRecord:
    """Return a record with errors of the localisation [m, rad] that drift, as AMCL's do."""
    random = np.random.default_rng(seed)
    out = []
    for each in seen.sightings:
        drift = np.zeros((len(each.poses), 3))
        for row in range(1, len(drift)):
            drift[row] = keeps * drift[row - 1] + math.sqrt(1 - keeps**2) * random.normal(size=3)
        out.append(replace(each, poses=each.poses + drift * (place, place, heading)))
    return replace(seen, sightings=tuple(out))


@pytest.fixture(scope="module")
def true(tmp_path_factory) -> tuple[NavigationTask, DriveRecord]:
    folder = tmp_path_factory.mktemp("true")
    task = room(folder)
    return task, record(task, folder / "bag", episodes=EPISODES)


def walls_of(account: Account) -> list[str]:
    return [place.kind for place in account.moved_walls]


def test_a_true_world_is_not_refused(true: tuple[NavigationTask, DriveRecord]) -> None:
    task, seen = true
    account = examine(seen, task)
    assert (account.refusal, account.lines) == ("", [])
    assert account.differing < 0.001
    for place, heading in ((0.02, math.radians(0.5)), (0.04, math.radians(1.0))):
        told = examine(mistaken(seen, place, heading), task)
        assert told.refusal == "", told.lines


DISTANCES = (0.1, 0.3, 0.5)


@pytest.mark.parametrize(
    ("by", "index"),
    [
        pytest.param(by, index, marks=[pytest.mark.slow] if index != place else [])
        for place, by in enumerate(DISTANCES)
        for index in range(len(BOXES))
    ],
)
def test_a_moved_box_is_told_and_refused(
    true: tuple[NavigationTask, DriveRecord], tmp_path: Path, by: float, index: int
) -> None:
    """Each box is moved to another side."""
    _, seen = true
    boxes, angle = list(BOXES), 0.5 * math.pi * index
    x, y, *size = boxes[index]
    boxes[index] = (x + by * math.cos(angle), y + by * math.sin(angle), *size)
    file = room(tmp_path, boxes)
    account = examine(seen, file)
    assert "--map-from-bag" in account.refusal, account.lines
    assert max(math.dist(place.centre, boxes[index][:2]) for place in account.moved_walls) < 0.5 + by
    again = examine(mistaken(seen, 0.02, math.radians(0.5)), file)
    # Seen with errors of the pose, 10 cm are told, and more is refused.
    assert again.refusal or (by == 0.1 and again.places), again.lines


def test_boxes_that_are_missing_in_the_file_or_in_the_world_are_told_apart(
    true: tuple[NavigationTask, DriveRecord], tmp_path: Path
) -> None:
    _, seen = true
    added = examine(seen, room(tmp_path / "added", (*BOXES, (-0.2, -0.9, 0.3, 0.3))))
    assert set(walls_of(added)) == {"missing"}
    assert "is not there" in " ".join(added.lines)
    removed = examine(seen, room(tmp_path / "removed", BOXES[1:]))
    assert set(walls_of(removed)) == {"unknown"}
    (place, *_) = removed.moved_walls
    assert math.dist(place.centre, BOXES[0][:2]) < 0.3
    assert place.episodes >= EPISODES - 1


def test_what_moves_is_no_moved_wall(tmp_path: Path) -> None:
    walker = {"radius": "0.15 m", "wander": {"points": 12, "speed": "0.1 .. 0.3 m/s"}}
    walked = room(tmp_path / "world", movers=[deepcopy(walker) for _ in range(3)])
    seen = record(walked, tmp_path / "bag", episodes=6)
    account = examine(seen, room(tmp_path / "file"))
    assert account.refusal == "", account.lines
    assert "something that moves" in " ".join(account.lines)
    assert examine(seen, walked).lines == []


@pytest.mark.parametrize(
    ("shift", "turn"), [((0.2, 0.0), 0.0), ((-0.15, 0.2), math.radians(4.0)), ((0.0, 0.0), math.radians(-6.0))]
)
def test_an_offset_of_the_poses_is_no_moved_wall(
    true: tuple[NavigationTask, DriveRecord], tmp_path: Path, shift: tuple[float, float], turn: float
) -> None:
    task, seen = true
    wrong = Offset(shift, turn, (0.0, 0.0))
    moved = replace(seen, sightings=tuple(wrong.moved(each) for each in seen.sightings))
    account = examine(moved, task)
    assert account.offset is not None
    assert account.offset.turn == pytest.approx(-turn, abs=math.radians(0.5))
    assert account.moved_walls == []
    assert "localisation" in account.refusal
    both = examine(moved, room(tmp_path, BOXES[1:]))
    assert both.offset is not None
    assert walls_of(both)


def test_odometry_that_began_elsewhere_is_found_in_the_files_frame(
    true: tuple[NavigationTask, DriveRecord],
) -> None:
    task, seen = true
    wrong = Offset((1.4, -0.9), math.radians(70.0), (0.0, 0.0))
    drifting = mistaken(seen, 0.03, 0.0, keeps=0.99)
    account = examine(replace(drifting, sightings=tuple(wrong.moved(each) for each in drifting.sightings)), task)
    assert account.offset is not None
    assert account.offset.turn == pytest.approx(math.radians(-70.0), abs=math.radians(1.0))
    assert account.moved_walls == []
    assert "not in the frame" in account.refusal


def test_a_drift_of_the_poses_is_no_moved_wall(true: tuple[NavigationTask, DriveRecord]) -> None:
    task, seen = true
    account = examine(mistaken(seen, 0.3, 0.0, seed=1, keeps=0.99), task)
    assert account.drift > 0.2
    assert account.moved_walls == []
    assert "not of odometry alone" in account.refusal
    drifts = task.model_copy(update={"randomisation": {"odom_drift": Interval(0.0, 0.2)}})
    assert examine(mistaken(seen, 0.3, 0.0, seed=1, keeps=0.99), drifts).refusal == ""


def test_speeds_commands_and_states_beyond_the_file_are_told(
    true: tuple[NavigationTask, DriveRecord], tmp_path: Path
) -> None:
    task, seen = true
    fast = examine(replace(seen, speeds=seen.speeds * 3.0, commands=seen.commands * 3.0), task)
    assert "exceed what the task's robot can do" in fast.refusal
    assert any("commands ask for a speed beyond the task's" in line for line in fast.lines)
    place = seen.sightings[0].poses[len(seen.sightings[0].poses) // 2, :2]
    inside = examine(seen, room(tmp_path, (*BOXES, (*place.tolist(), 0.6, 0.6))))
    assert any("inside what the file calls a collision" in line for line in inside.lines)
    assert inside.refusal


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 4))])
def test_random_rooms(tmp_path: Path, seed: int) -> None:
    """A room of boxes drawn at random is not refused; with one of them moved, removed or added it is."""
    random = np.random.default_rng(seed)
    boxes: list[Box] = []
    while len(boxes) < 4:
        x, y, *size = random.uniform((-1.6, -1.6, 0.2, 0.2), (1.8, 1.6, 0.6, 0.6)).tolist()
        if all(math.dist((x, y), other[:2]) > 1.0 for other in boxes):
            boxes.append((x, y, *size))
    task = room(tmp_path / "true", boxes)
    seen = mistaken(record(task, tmp_path / "bag", episodes=5, seed=seed), 0.02, math.radians(0.5), seed)
    assert examine(seen, task).refusal == ""
    by, angle = random.uniform(0.1, 0.5), random.uniform(-math.pi, math.pi)
    x, y, *size = boxes[0]
    moved = [(x + by * math.cos(angle), y + by * math.sin(angle), *size), *boxes[1:]]
    for name, others in (("moved", moved), ("removed", boxes[1:])):
        account = examine(seen, room(tmp_path / name, others))
        assert account.refusal, (name, by, account.lines)


def test_a_map_from_the_bag_is_the_world(true: tuple[NavigationTask, DriveRecord], tmp_path: Path) -> None:
    task, seen = true
    x, y, *size = BOXES[0]
    wrong = room(tmp_path / "file", ((x + 0.3, y, *size), *BOXES[1:]))
    file = task_with_map(
        map_from_record(seen, wrong), wrong, str(tmp_path / "file" / "room.yaml"), tmp_path / "map", "bag"
    )
    mapped = load_navigation_task(file)
    assert (mapped.name, mapped.obstacles, mapped.arena) == ("room_map", (), None)
    assert (mapped.start, mapped.goal, mapped.robot) == (wrong.start, wrong.goal, wrong.robot)
    account = examine(seen, mapped)
    assert account.refusal == "", account.lines
    # As near to the true walls as its cells: where robots can drive, clearances are those of the true world.
    points = np.random.default_rng(0).uniform((-2.8, -1.8), (2.8, 1.8), (2000, 2))
    by_map, truly = (each.build_world().signed_distance(points) for each in (mapped, task))
    free = truly > 0.15
    assert np.abs(by_map - truly)[free].max() < 0.12
    assert (by_map[truly < -0.06] < 0.1).all()
    assert map_from_record(seen, task).changed < 0.02 * map_from_record(seen, task).map.cells.size


def test_the_picture_shows_walls_beams_and_drives(true: tuple[NavigationTask, DriveRecord], tmp_path: Path) -> None:
    _, seen = true
    account = examine(seen, room(tmp_path, BOXES[1:]))
    draw_account(account, tmp_path / "told.png")
    assert (tmp_path / "told.png").stat().st_size > 10_000
    assert len(account.paths) == EPISODES


def shifted_box(folder: Path, episodes: int) -> tuple[NavigationTask, Path, list[str], list[str]]:
    """Record drives in a room whose file has a box 30 cm off.

    Returns the true room, the file for a policy, and options of commands: the bag, and quick learning.
    """
    world, file = room(folder / "world"), folder / "file" / "room.yaml"
    x, y, *size = BOXES[0]
    room(file.parent, ((x + 0.3, y, *size), *BOXES[1:]))
    drive(world, ScriptedDriver(world), episodes, 0, folder / "bag")
    common = [str(folder / "bag"), "--task", str(file), "--other-task"]
    policy = folder / "out" / "policy.safetensors"
    quick = ["--output", str(policy), "--updates", "20", "--hidden", "8", "--values", str(folder / "values")]
    return world, policy, common, quick


def test_commands_refuse_bags_of_other_walls(tmp_path: Path, capsys) -> None:
    _, policy, common, quick = shifted_box(tmp_path, 6)
    assert learn_offline([*common, *quick]) == 2
    said = capsys.readouterr()
    assert "a wall at" in said.err
    assert "--map-from-bag" in said.err.splitlines()[-1]
    assert not policy.exists()
    assert (tmp_path / "out" / "policy.differences.png").is_file()
    # Cloning believes no walls.
    assert learn_offline([*common, *quick, "--method", "bc"]) == 0
    assert "a wall at" in capsys.readouterr().err
    assert evaluate_offline([*common, "--policy", str(policy), "--updates", "20", "--fits", "1"]) == 2
    assert "--map-from-bag" in capsys.readouterr().err


def test_commands_go_by_the_map_from_the_bag(tmp_path: Path, capsys) -> None:
    world, policy, common, quick = shifted_box(tmp_path, 6)
    assert learn_offline([*common, *quick, "--map-from-bag"]) == 0
    said = capsys.readouterr()
    assert "a wall at" not in said.err
    assert "room_map.yaml --other-task --policy" in said.out
    mapped = load_navigation_task(tmp_path / "out" / "room_map.yaml")
    assert Actor.load(policy).manifest["task_digest"] == task_digest(mapped)
    judged = ["--policy", str(policy), "--updates", "20", "--fits", "1"]
    by_file = [common[0], "--task", str(tmp_path / "out" / "room_map.yaml"), "--other-task"]
    for named in ([*common, "--map-from-bag"], by_file):
        assert evaluate_offline([*named, *judged]) == 1  # hardly taught, and not called better
        said = capsys.readouterr()
        assert "verdict" in said.out
        assert "was trained on another version" not in said.err
    # A map of other walls is not overwritten, and rewards of the file's walls do not count among the map's.
    drive(room(tmp_path / "other", BOXES[1:]), ScriptedDriver(world), 4, 0, tmp_path / "bag2")
    others = [str(tmp_path / "bag2"), *common[1:], "--map-from-bag"]
    assert learn_offline([*others, *quick[:1], str(tmp_path / "out" / "next.safetensors")]) == 1
    assert "exists with different walls" in capsys.readouterr().err
    assert learn_offline([*common, *quick, "--map-from-bag", "--method", "iql", "--overwrite"]) == 1
    assert "relabel the bags for the map's task room_map" in capsys.readouterr().err


def test_a_corridor_has_no_map(tmp_path: Path, capsys) -> None:
    task = load_navigation_task("curved_corridor")
    drive(task, ScriptedDriver(task), 1, 0, tmp_path / "bag")
    learn = [str(tmp_path / "bag"), "--task", "curved_corridor", "--map-from-bag"]
    assert learn_offline([*learn, "--output", str(tmp_path / "policy.safetensors")]) == 1
    assert "fix 'corridor' in its file" in capsys.readouterr().err


def test_learning_in_process_refuses_bags_of_other_walls(
    true: tuple[NavigationTask, DriveRecord], tmp_path: Path
) -> None:
    task, seen = true
    drive(task, ScriptedDriver(task), 2, 0, tmp_path / "bag")
    data = read_drives(tmp_path / "bag", task)
    assert data.refusal == ""
    told = replace(data, refusal=examine(seen, room(tmp_path, BOXES[1:])).refusal)
    with pytest.raises(LearningError, match="--map-from-bag"):
        learn_from_drives(told, "value_model")
    assert learn_from_drives(told, "bc", updates=5).manifest["method"] == "bc"


def test_rays_through_a_map_end_at_its_walls() -> None:
    cells = np.zeros((40, 60), np.int8)
    cells[20:22, 30:40], cells[:1] = 100, 100
    place = OccupancyMap(cells, 0.05, (1.0, -2.0, 0.4))
    random = np.random.default_rng(0)
    lidars = np.column_stack(
        (place.cell_to_world(random.integers(5, 15, 50), random.integers(0, 60, 50)), np.arange(50.0))
    )
    bearings = np.linspace(-3.0, 3.0, 40)
    ranges, exact = map_ranges(place, lidars, bearings, 2.0), np.empty((50, 40))
    scans(np.array([shape_row(box) for box in place.boxes()]), lidars, bearings, 2.0, exact)
    found = np.isfinite(ranges) & np.isfinite(exact)
    assert 0.1 < found.mean() < 0.9
    assert (np.isfinite(ranges) != np.isfinite(exact)).mean() < 0.01  # corners, and the end of the rays
    assert np.quantile(np.abs(ranges[found] - exact[found]), 0.99) < 0.02
