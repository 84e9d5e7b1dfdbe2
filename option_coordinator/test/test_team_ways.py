"""A team with a room that blocks a robot's path is rejected before driving and learning."""

from pathlib import Path

import pytest
import yaml
from option_coordinator.environments import check_ways
from option_coordinator.teams import load_room

from option_coordinator import OptionError, load_team, team_file


def team_in(folder: Path, **obstacle: object) -> Path:
    """Write the delivery team with another room and return its file."""
    room = yaml.safe_load((team_file("delivery_team").parent / "delivery_room.yaml").read_text())
    room |= {"name": "room", "obstacles": [obstacle]}
    (folder / "room.yaml").write_text(yaml.safe_dump(room))
    team = yaml.safe_load(team_file("delivery_team").read_text()) | {"name": "my_team", "room": "room.yaml"}
    (folder / "my_team.yaml").write_text(yaml.safe_dump(team))
    return folder / "my_team.yaml"


def test_the_shipped_team_finds_its_ways() -> None:
    team = load_team("delivery_team")
    check_ways(team, load_room(team))


def test_a_wall_between_two_stations_is_named(tmp_path: Path) -> None:
    file = team_in(tmp_path, box={"centre": "(0.0, 0.3) m", "size": "(0.1, 1.9) m"})
    team = load_team(str(file))
    with pytest.raises(OptionError, match=r"in room 'room' a robot does not get from '\w+' to '\w+' within"):
        check_ways(team, load_room(team))


def test_a_small_box_is_gone_round(tmp_path: Path) -> None:
    team = load_team(str(team_in(tmp_path, box={"centre": "(0.0, 0.35) m", "size": "(0.4, 0.2) m"})))
    check_ways(team, load_room(team))
