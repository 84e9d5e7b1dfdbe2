"""A team whose robots do not get from place to place is refused when it is loaded; two that meet find a way."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from option_coordinator.environments.tasks.team_delivery import TeamDeliverySimulation

from option_coordinator import OptionError, load_team, team_file

pytestmark = pytest.mark.fault


def team_in(folder: Path, *obstacles: dict[str, str], **changes: object) -> Path:
    """Write the delivery team with other obstacles in its room, and return its file."""
    room = yaml.safe_load((team_file("delivery_team").parent / "delivery_room.yaml").read_text())
    room |= {"name": "room", "obstacles": [{"box": box} for box in obstacles]} | changes.pop("room", {})  # type: ignore[operator]
    (folder / "room.yaml").write_text(yaml.safe_dump(room))
    team = yaml.safe_load(team_file("delivery_team").read_text()) | {"name": "my_team", "room": "room.yaml"} | changes
    (folder / "my_team.yaml").write_text(yaml.safe_dump(team, sort_keys=False))
    return folder / "my_team.yaml"


def aisle_team(folder: Path, width: float) -> Path:
    """Write a team of two whose shelves and desks lie at the ends of an aisle with a width [m]."""
    high = 1.2 - 0.5 * width
    middle = 0.5 * (1.2 + 0.5 * width)
    boxes = [{"centre": f"(0.0, {sign * middle}) m", "size": f"(1.5, {high}) m"} for sign in (1, -1)]
    room = {
        "arena": {"x": "-3.0 .. 3.0 m", "y": "-1.2 .. 1.2 m", "wall_thickness": "0.1 m"},
        "start": {"x": "-2.4 .. -1.2 m", "y": "-0.8 .. 0.8 m", "theta": "-45.0 .. 45.0 deg"},
    }
    places = {"shelf_1": (-2.3, 0.4), "shelf_2": (-2.3, -0.4), "desk_1": (2.3, 0.4), "desk_2": (2.3, -0.4)}
    options: dict[str, dict[str, str]] = {"wait": {"work": "wait", "longest": "5.0 s", "lasts": "2.0 s"}}
    for name, (x, y) in places.items():
        work = "fetch" if "shelf" in name else "deliver"
        options[name] = {"work": work, "longest": "120.0 s", "station": f"({x}, {y}) m"}
    options["home"] = {"work": "rest", "longest": "120.0 s"}
    robots = {f"robot_{number}": {"home": f"(-1.4, {y}) m"} for number, y in ((1, -0.35), (2, 0.35))}
    return team_in(folder, *boxes, room=room, options=options, robots=robots)


def test_a_wall_that_cuts_the_room_in_two_is_named_with_robot_and_station(tmp_path: Path) -> None:
    file = team_in(tmp_path, {"centre": "(0.45, 0.0) m", "size": "(0.1, 3.0) m"})
    words = "robot_1 has no way from 'shelf_1' to 'desk_1' in room 'room': walls or obstacles separate them"
    with pytest.raises(OptionError, match=words):
        load_team(str(file))


def test_a_wall_that_the_steering_does_not_get_round_is_refused(tmp_path: Path) -> None:
    file = team_in(tmp_path, {"centre": "(0.0, 0.3) m", "size": "(0.1, 1.9) m"})
    with pytest.raises(OptionError, match=r"robot_1 has no way from '\w+' to '\w+' in room 'room'.*goes round small"):
        load_team(str(file))


def test_a_pocket_that_catches_a_robot_alone_is_refused(tmp_path: Path) -> None:
    pocket = [
        {"centre": "(0.6, 1.0) m", "size": "(0.1, 0.9) m"},
        {"centre": "(0.25, 0.6) m", "size": "(0.7, 0.1) m"},
        {"centre": "(0.25, 1.4) m", "size": "(0.7, 0.1) m"},
    ]
    with pytest.raises(OptionError, match=r"has no way from 'shelf_1' to 'desk_1' in room 'room' that its steering"):
        load_team(str(team_in(tmp_path, *pocket)))


def test_a_small_box_is_gone_round(tmp_path: Path) -> None:
    load_team(str(team_in(tmp_path, {"centre": "(0.0, 0.35) m", "size": "(0.4, 0.2) m"})))


def test_a_way_that_takes_too_long_is_refused_with_the_limit_to_raise(tmp_path: Path) -> None:
    file = team_in(tmp_path)
    file.write_text(
        file.read_text().replace(
            "longest: 60.0 s\n    station: (1.65, 1.0) m", "longest: 9.0 s\n    station: (1.65, 1.0) m"
        )
    )
    with pytest.raises(OptionError, match=r"within 9 s: it takes \d+ s; raise options\.desk_1\.longest"):
        load_team(str(file))


def test_a_station_too_near_a_wall_for_the_steering_is_refused(tmp_path: Path) -> None:
    file = team_in(tmp_path)
    file.write_text(file.read_text().replace("(1.65, 1.0) m", "(1.877, 1.0) m"))
    with pytest.raises(OptionError, match=r"options\.desk_1\.station: .* lies 0\.123 m from .* needs 0\.3 m to steer"):
        load_team(str(file))


@pytest.mark.parametrize("width", [0.4, 0.5])
def test_an_aisle_too_narrow_for_the_steering_is_refused_with_its_width(tmp_path: Path, width: float) -> None:
    with pytest.raises(OptionError, match=rf"the widest is {width} m wide, its steering needs 0\.7 m; widen the room"):
        load_team(str(aisle_team(tmp_path, width)))


@pytest.mark.parametrize("width", [0.7, 0.8])
@pytest.mark.parametrize(("desk", "shelf", "delay"), [("desk_1", "shelf_1", 0), ("desk_2", "shelf_1", 20)])
def test_two_that_meet_in_an_aisle_get_past_each_other(
    tmp_path: Path, width: float, desk: str, shelf: str, delay: int
) -> None:
    """Neither has room to pass: one backs out. Without that, both stand until their options overrun."""
    team = load_team(str(aisle_team(tmp_path, width)))
    simulation = TeamDeliverySimulation(team)
    simulation._poses = np.array(((-2.3, 0.0, 0.0), (2.3, 0.0, np.pi)))
    ended: dict[int, float] = {}
    nearest = math.inf
    simulation.begin(0, team.option_names.index(desk))
    for step in range(round(team.options[desk].longest / team.time_step)):
        if step == delay:
            simulation.begin(1, team.option_names.index(shelf))
        for agent in np.flatnonzero(simulation.step().ended):
            ended.setdefault(int(agent), step * team.time_step)
        nearest = min(nearest, math.dist(simulation._poses[0, :2], simulation._poses[1, :2]))
    assert ended.keys() == {0, 1}
    assert max(ended.values()) < 110.0
    assert nearest > 0.246  # two burgers
