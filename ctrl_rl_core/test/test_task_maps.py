"""Tasks on an occupancy map, and randomised ranges."""

from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
import yaml
from ctrl_rl_core.tasks.task import FOLDER, task_digest

from ctrl_rl_core import NavigationTask, OccupancyMap, TaskError, load_navigation_task, load_task, task_names


@pytest.fixture
def content(tmp_path: Path) -> dict:
    """A task on a map of 4 m x 3 m with walls around it, stored in a folder next to the task's."""
    cells = np.zeros((60, 80), np.int8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = 100, 100, 100, 100
    (tmp_path / "maps").mkdir()
    OccupancyMap(cells, 0.05, (-2.0, -1.5, 0.0)).save(tmp_path / "maps" / "room.yaml")
    return {
        "name": "own",
        "kind": "navigation",
        "about": "A burger in a room.",
        "source": "tests",
        "system": {"model": "dubins_car"},
        "robot": {
            "body": "turtlebot3_burger",
            "commands": {"v": "-0.22 .. 0.22 m/s", "omega": "-2.84 .. 2.84 rad/s"},
        },
        "map": {"file": "maps/room.yaml"},
        "start": {"x": "0.0 m", "y": "0.0 m", "theta": "0.0 rad"},
        "goal": {"x": "1.0 .. 1.5 m"},
        "episode": {"steps": 100, "time_step": "0.2 s"},
        "rewards": {"goal": 1, "collision": -1},
        "lidar": {"beams": 360, "field": "0.0 .. 360.0 deg", "range": "0.12 .. 3.5 m", "rate": "5.0 Hz"},
    }


def load(folder: Path, content: dict):
    (folder / "own.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return load_navigation_task(folder / "own.yaml")


def test_occupied_cells_are_walls(tmp_path, content):
    task = load(tmp_path, content)
    world = task.build_world()
    assert len(world.walls) == 4
    points = np.array(((0.0, 0.0), (1.8, 0.0), (1.95, 0.0)))
    np.testing.assert_allclose(world.signed_distance(points), (1.4, 0.1, -0.05), atol=1e-9)
    assert task.plane_bounds["x"] == pytest.approx((-2.0, 2.0))
    assert task.plane_bounds["y"] == pytest.approx((-1.5, 1.5))


def test_a_task_is_what_its_map_holds_wherever_that_lies(tmp_path, content):
    first = load(tmp_path, content)
    (tmp_path / "maps").rename(tmp_path / "moved")
    again = load(tmp_path, {**content, "map": {"file": str(tmp_path / "moved" / "room.yaml")}})
    assert task_digest(again) == task_digest(first)
    cells = first.map.map.cells.copy()
    cells[30, 40] = 100
    OccupancyMap(cells, 0.05, (-2.0, -1.5, 0.0)).save(tmp_path / "moved" / "room.yaml")
    assert task_digest(load(tmp_path, {**content, "map": {"file": "moved/room.yaml"}})) != task_digest(first)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"map": {"file": "nowhere.yaml"}}, r"own\.yaml.*nowhere\.yaml"),
        ({"map": {}}, "map.file: is missing"),
        (
            {"arena": {"x": "0 .. 1 m", "y": "0 .. 1 m", "wall_thickness": "0.1 m"}},
            "needs either 'arena', 'corridor' or 'map'",
        ),
        ({"randomisation": {"friction": "0.0 .. 1.0"}}, "'friction' 0 .. 1: must be within 0.01 .. 10"),
        ({"randomisation": {"grip": "0.5 .. 1.0"}}, "'grip': no such name"),
        ({"randomisation": {"motor_lag": "0.5 .. 1.0"}}, "has no unit: must be in s"),
    ],
)
def test_a_wrong_map_or_range_is_refused_in_one_line(tmp_path, content, change, complaint):
    with pytest.raises(TaskError, match=complaint) as caught:
        load(tmp_path, {**content, **change})
    assert "\n" not in str(caught.value)


def test_a_flying_robot_draws_nothing_about_wheels(tmp_path):
    content = yaml.safe_load((FOLDER / "quad_ttr.yaml").read_text())
    content |= {"name": "own", "randomisation": {"command_delay": "0 .. 50 ms"}}
    assert load(tmp_path, content).randomisation == {"command_delay": (0.0, 0.05)}
    with pytest.raises(TaskError, match=r"randomisation\.friction: a flying robot has no wheels"):
        load(tmp_path, {**content, "randomisation": {"friction": "0.5 .. 1.0"}})


def test_a_task_without_newer_parts_keeps_its_digest():
    newer = ("map", "movers", "randomisation", "doorways")
    for name in task_names():
        task = load_task(name)
        unused = {key for key in newer if not getattr(task, key, None)}
        left_out = dict.fromkeys(("about", "source", "differences", *unused), True)
        if isinstance(task, NavigationTask):
            left_out["robot"] = {"footprint"}
            if not task.system.states:
                left_out["system"] = {"states"}
            if task.corridor is not None:
                left_out["corridor"] = {"openings"}
        before = task.model_dump_json(exclude=left_out)
        assert task_digest(task) == sha256(before.encode()).hexdigest()
        if isinstance(task, NavigationTask):
            shifted = task.model_copy(update={"randomisation": {"odom_drift": (0.0, 0.1)}})
            assert task_digest(shifted) != task_digest(task)
