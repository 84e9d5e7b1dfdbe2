"""Loads team files, and checks each one against its room."""

from __future__ import annotations

import math
from itertools import combinations

from ctrl_rl_core.io import FileError, raise_as, read_yaml, short_repr

from ctrl_rl_core import NavigationTask, load_navigation_task
from option_coordinator.errors import OptionError
from option_coordinator.navigation.planner import ReactivePlanner
from option_coordinator.teams.team_file import TeamFile, room_file, team_file
from option_coordinator.teams.ways import check_ways


def load_room(team: TeamFile, name_or_path: str = "") -> NavigationTask:
    """Load the room of a team.

    Args:
        team: Team that works in the room.
        name_or_path: Room to use in place of the team's own; empty for the team's own.

    Raises:
        CtrlRlError: The room does not exist, or the team's homes and stations are not in its free space, or not
            connected.
    """
    room = load_navigation_task(room_file(name_or_path) if name_or_path else team.room_file)
    check_places(team, room)
    check_ways(team, room)
    return room


def check_places(team: TeamFile, room: NavigationTask) -> None:
    """Check that each home and station has room for a robot and its steering, and that all robots fit at home.

    Raises:
        OptionError: A home or station is not free; the message names it.
    """
    world, radius = room.build_world(), room.robot.radius
    needed = max(radius, ReactivePlanner.clearance)
    homes = {f"robots.{name}.home": robot.home for name, robot in team.robots.items()}
    stations = {f"options.{name}.station": o.station for name, o in team.options.items() if o.station is not None}
    for key, place in (homes | stations).items():
        words = f"{key}: ({place[0]:g}, {place[1]:g}) m"
        bounds = room.plane_bounds.values()
        if not all(low <= value <= high for value, (low, high) in zip(place, bounds, strict=True)):
            raise OptionError(f"{words} lies outside room '{room.name}'")
        clearance = float(world.signed_distance(place))
        if clearance < needed - 1e-6:
            raise OptionError(
                f"{words} lies {max(clearance, 0.0):.3g} m from a wall or an obstacle of room '{room.name}': "
                f"a {room.robot.body} needs {needed:g} m to steer there"
            )
    for (key, place), (other, there) in combinations(homes.items(), 2):
        if math.dist(place, there) < 2.0 * radius:
            raise OptionError(
                f"{key} and {other} lie {math.dist(place, there):.3g} m apart: two robots need {2.0 * radius:g} m"
            )


def load_team(name_or_path: str) -> TeamFile:
    """Load a team by name or file, and check it against its room.

    Raises:
        OptionError: The team does not exist or is invalid; the message names file and key.
    """
    path = team_file(name_or_path)
    with raise_as(OptionError, path):
        team = TeamFile.model_validate(read_yaml(path))
        if team.name != path.stem:
            raise FileError(f"name: is {short_repr(team.name)}, must be the file's name {short_repr(path.stem)}")
        team.place(path.resolve().parent)
        load_room(team)
    return team
