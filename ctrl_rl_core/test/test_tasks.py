"""Task files: the suite's own are valid, and errors name the faulty key."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from ctrl_rl_core.tasks.regions import wrap
from ctrl_rl_core.tasks.task import FOLDER

from ctrl_rl_core import NavigationTask, TaskError, load_navigation_task, load_task, task_digest, task_names

MOVING = ("corridor_crossing", "corridor_cutting_in", "corridor_head_on", "corridor_sudden", "walkers")
NAVIGATION = (
    *("car_ttr", "car_ttr_randomised", "quad_ttr", "car_navigation", "quad_navigation", "quad_trap"),
    *("curved_corridor", "corridor_doorways", *MOVING),
)


def changed(tmp_path: Path, name: str, old: str, new: str) -> Path:
    text = (FOLDER / f"{name}.yaml").read_text()
    assert old in text
    path = tmp_path / f"{name}.yaml"
    path.write_text(text.replace(old, new, 1))
    return path


def test_all_tasks_of_the_suite_are_there_and_whole() -> None:
    assert set(task_names()) == {*NAVIGATION, "tool_delivery", "water_filling"}
    for name in task_names():
        task = load_task(name)
        assert task.name == name
        assert task.differences, "names where thesis and published code differ"
        assert re.fullmatch("[0-9a-f]{64}", task_digest(task))


@pytest.mark.parametrize("name", NAVIGATION)
def test_starts_are_free_and_goals_can_be_stood_in(name: str) -> None:
    task = load_navigation_task(name)
    world = task.build_world()
    random = np.random.default_rng(0)
    for region in (task.start.region, task.goal.region):
        if world.path is None:
            names = task.system.build().state_names
            states = np.array([region.sample(names, random) for _ in range(50)])
            assert region.contains(names, states).all()
            points = states[:, [names.index("x"), names.index(task.plane[1])]]
        else:
            states = np.array([region.sample(("s", "lateral", "heading"), random) for _ in range(50)])
            points = world.path.pose(states[:, 0])[:, :2]
        assert (world.signed_distance(points) > 0.0).mean() > 0.9


def test_the_thesis_goal_of_the_car_wraps_its_heading() -> None:
    goal = load_navigation_task("car_ttr").goal.region
    names = ("x", "y", "theta")
    states = [[4.0, 4.0, 0.7], [4.0, 4.0, 0.7 - 2 * np.pi], [4.0, 4.0, 1.2], [3.6, 4.0, 0.7]]
    assert goal.contains(names, states).tolist() == [True, True, False, False]
    assert wrap([np.pi, -np.pi, 3.5]) == pytest.approx([-np.pi, -np.pi, 3.5 - 2 * np.pi])


def test_constants_come_out_in_si_units() -> None:
    task = load_navigation_task("quad_trap")
    assert task.system.build().parameters["I_yy"] == 0.03
    assert task.goal.intervals["psi"].high == pytest.approx(np.pi / 3)
    assert task.trap is not None
    assert task.trap.region.contains(("x", "z", "psi"), [-2.0, 0.5, 0.0])
    assert task.rewards.timeout == -1000
    assert load_navigation_task("car_ttr").system.build().control_bounds[:, 0].tolist() == [1.0, 1.0]


def test_a_system_with_some_parameters_scaled_is_otherwise_the_same() -> None:
    spec = load_navigation_task("quad_navigation").system
    one, other = spec.build(), spec.scaled({"m": 1.1, "I_yy": 0.5}).build()
    changed = {name for name in one.parameters if one.parameters[name] != other.parameters[name]}
    assert changed == {"m", "I_yy"}
    assert other.parameters["m"] == pytest.approx(1.1 * 1.25, rel=1e-15)
    assert other.parameters["I_yy"] == pytest.approx(0.5 * 0.03, rel=1e-15)
    assert (other.control_bounds == one.control_bounds).all()
    with pytest.raises(ValueError, match="'mass': no such name; there are m, g"):
        spec.scaled({"mass": 1.1})
    with pytest.raises(ValueError, match="'m' is 0; it must be more than zero"):
        spec.scaled({"m": 0.0})


def test_a_task_says_within_which_bounds_the_state_stays(tmp_path: Path) -> None:
    old = "controls: {T_1"
    task = load_task(changed(tmp_path, "quad_ttr", old, f"states: {{v_x: -3.0 .. 3.0 m/s}}\n  {old}"))
    assert isinstance(task, NavigationTask)
    speed = task.system.build().states[1]
    assert (speed.name, speed.lower, speed.upper) == ("v_x", -3.0, 3.0)
    assert task.system.scaled({"m": 1.1}).build().states[1] == speed
    assert task_digest(task) != task_digest(load_task("quad_ttr"))
    with pytest.raises(TaskError, match="system: 'v': no such name"):
        load_task(changed(tmp_path, "quad_ttr", old, f"states: {{v: -3.0 .. 3.0 m/s}}\n  {old}"))


def test_the_lidar_of_the_burger_has_a_beam_per_degree() -> None:
    lidar = load_navigation_task("curved_corridor").lidar
    assert lidar.angle_min == 0.0
    assert lidar.angle_increment == pytest.approx(np.pi / 180)
    eight = load_navigation_task("car_ttr").lidar
    assert eight.angle_increment == pytest.approx(np.pi / 8)
    assert eight.angle_min == pytest.approx(-np.pi / 2 + np.pi / 16)


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("car_ttr", "goal: {x:", "gaol: {x:", "goal: is missing"),
        ("car_ttr", "about:", "abuot:", "about: is missing"),
        ("car_ttr", "arena: {x: -5.046 .. 4.763 m", "arena: {x: -5.046 .. 4.763 s", "arena.x: .*unit 's'"),
        ("car_ttr", "arena: {x: -5.046 .. 4.763 m", "arena: {x: -5.046 .. 4.763", "arena.x: .*no unit"),
        ("car_ttr", 'size: "(0.7, 0.7) m"', 'size: "(0.7, 0.7, 0.7) m"', r"obstacles.0.box.size: .*has 3 numbers"),
        ("car_ttr", "model: dubins_car", "model: dubins_cart", "system: model: unknown system 'dubins_cart'"),
        ("car_ttr", "omega: -1.0 .. 1.0 rad/s", "omga: -1.0 .. 1.0 rad/s", "system: 'omga': no such name"),
        ("quad_ttr", "m: 1.25 kg", "m: 1.25 m", "system: .*unit 'm'"),
        ("quad_ttr", "m: 1.25 kg", "m: -1.25 kg", "system: planar_quadrotor"),
        ("car_ttr", "steps: 75", "steps: 0", "episode.steps: .*greater than 0"),
        ("car_ttr", "body: turtlebot2", "body: turtlebot9", "robot.body: "),
        ("car_ttr", "theta: 0.45 .. 1.05 rad", "psi: 0.45 .. 1.05 rad", "goal.psi: no such state"),
        ("curved_corridor", "width: 0.7 m", "width: 0.9 m", "corridor: width: lies outside width_range"),
        ("curved_corridor", "radius: 1.0 m", "radius: 0.3 m", "corridor: .*too tight"),
        ("curved_corridor", "name: curved_corridor", "name: corridor", "name: is 'corridor', must be"),
        ("curved_corridor", "kind: navigation", "kind: dancing", "'kind' is 'dancing': must be one of 'navigation', "),
        ("curved_corridor", "kind: navigation", "sort: navigation", "'kind' is missing"),
        ("tool_delivery", "tools: [0, 1, 2]", "tools: [0, 1, 3]", "tools: must number"),
        ("water_filling", "reach: 1.0 m", "reach: 1.0 s", "reach: .*unit 's'"),
        ("water_filling", "reach: 1.0 m", "reach: 1.0 m\nreach: 2.0 m", "'reach' stands twice"),
        ("water_filling", "reach: 1.0 m", "reach: {", "not valid YAML"),
    ],
)
def test_a_wrong_file_gives_one_error_that_names_file_and_key(
    tmp_path: Path, name: str, old: str, new: str, words: str
) -> None:
    path = changed(tmp_path, name, old, new)
    with pytest.raises(TaskError, match=words) as error:
        load_task(path)
    message = str(error.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message


def test_missing_tasks_and_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(TaskError, match="no task 'nowhere': there are car_navigation"):
        load_task("nowhere")
    with pytest.raises(TaskError, match="there is no such file"):
        load_task(tmp_path / "none.yaml")
    with pytest.raises(TaskError, match="a navigation task is needed"):
        load_navigation_task("tool_delivery")


def test_the_digest_follows_meaning_not_wording(tmp_path: Path) -> None:
    original = task_digest(load_task("curved_corridor"))
    for old, new in (("drives from its lidar", "rolls"), ("width: 0.7 m", "width: 70 cm")):
        assert task_digest(load_task(changed(tmp_path, "curved_corridor", old, new))) == original
    assert task_digest(load_task(changed(tmp_path, "curved_corridor", "steps: 700", "steps: 701"))) != original


def test_the_corridor_is_as_wide_as_asked_for_within_its_range() -> None:
    task = load_navigation_task("curved_corridor")
    world = task.build_world(width=0.6)
    assert world.path is not None
    middle = world.path.pose(np.linspace(0.5, 6.0, 50))[:, :2]
    assert world.signed_distance(middle) == pytest.approx(0.3, abs=3e-3)
    with pytest.raises(TaskError, match=r"allows 0.6 to 0.8 m"):
        task.build_world(width=1.0)
    with pytest.raises(TaskError, match="has no corridor"):
        load_navigation_task("car_ttr").build_world(width=0.7)


@pytest.mark.parametrize("key", yaml.safe_load((FOLDER / "quad_trap.yaml").read_text()))
def test_leaving_out_a_key_gives_another_task_or_one_clear_error(tmp_path: Path, key: str) -> None:
    content = yaml.safe_load((FOLDER / "quad_trap.yaml").read_text())
    del content[key]
    path = tmp_path / "quad_trap.yaml"
    path.write_text(yaml.safe_dump(content))
    if key in ("trap", "obstacles", "differences", "optimal_control"):
        load_task(path)
        return
    with pytest.raises(TaskError, match=key):
        load_task(path)
