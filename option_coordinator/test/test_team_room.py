"""A team file is checked against its room: the room's location, and free space at the robots' stations."""

import os

import pytest
from option_coordinator.environments.tasks.team_delivery import TeamDeliverySimulation
from option_coordinator.teams.loading import load_room
from option_coordinator.teams.team_file import FOLDER, room_names

from ctrl_rl_core import task_digest
from option_coordinator import OptionError, load_team

pytestmark = pytest.mark.fault


@pytest.fixture
def files(tmp_path):
    """Return a folder with a team file and its room in a subfolder."""
    (tmp_path / "rooms").mkdir()
    room = (FOLDER / "delivery_room.yaml").read_text().replace("name: delivery_room", "name: hall")
    (tmp_path / "rooms" / "hall.yaml").write_text(room)
    team = (FOLDER / "delivery_team.yaml").read_text().replace("name: delivery_team", "name: mine")
    (tmp_path / "mine.yaml").write_text(team.replace("room: delivery_room", "room: rooms/hall.yaml"))
    return tmp_path


def change(file, old, new):
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def test_a_room_counts_from_the_team_file_wherever_one_works(files, tmp_path_factory, monkeypatch):
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    team = load_team(os.path.relpath(files / "mine.yaml"))
    assert load_room(team).name == "hall"
    assert TeamDeliverySimulation(team).room == TeamDeliverySimulation(load_team("delivery_team")).room
    monkeypatch.chdir(files)
    assert task_digest(load_team("mine.yaml")) == task_digest(team)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"(0.9, -1.2) m"', '"(0.9, -1.8) m"', "robots.robot_3.home: (0.9, -1.8) m lies outside room 'hall'"),
        ('"(-1.65, 1.0) m"', '"(0.1, 0.3) m"', "options.shelf_1.station: (0.1, 0.3) m lies 0 m from"),
        ('"(1.65, 1.0) m"', '"(1.95, 1.0) m"', "options.desk_1.station: (1.95, 1) m lies 0.05 m from"),
        ('"(0.0, -1.2) m"', '"(0.8, -1.2) m"', "robots.robot_2.home and robots.robot_3.home lie 0.1 m apart"),
        ("room: rooms/hall.yaml", "room: hall.yaml", "hall.yaml: there is no such file"),
        ("room: rooms/hall.yaml", "room: nowhere", f"no room 'nowhere': there are {room_names()[0]}, car_navigation"),
        ("  robot_2:", "  robot_1:", "key 'robot_1' stands twice"),
    ],
)
def test_what_a_robot_cannot_do_is_refused_with_its_key(files, old, new, words):
    change(files / "mine.yaml", old, new)
    with pytest.raises(OptionError) as error:
        load_team(str(files / "mine.yaml"))
    assert words in str(error.value)
    assert str(error.value).startswith(str(files / "mine.yaml"))


def test_another_room_is_checked_as_well(files):
    change(files / "rooms" / "hall.yaml", "(0.3, 0.3) m", "(0.3, 3.0) m")
    change(files / "rooms" / "hall.yaml", "(0.0, 0.35) m", "(1.6, 0.0) m")
    with pytest.raises(OptionError, match=r"options\.desk_1\.station"):
        load_room(load_team("delivery_team"), str(files / "rooms" / "hall.yaml"))
