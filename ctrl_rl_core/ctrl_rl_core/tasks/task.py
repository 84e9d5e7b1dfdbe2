"""Tasks as validated YAML: one file for solver, MPC, simulator, rewards and reports.

    task = load_task("curved_corridor")     # a task of the suite, or a path to a file of your own
    world = task.build_world(width=0.65)

A wrong key, unit or shape raises one error that names file and key.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path as FilePath
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, TypeAdapter, ValidationError, ValidationInfo, model_validator

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.geometry.shapes import World
from ctrl_rl_core.geometry.units import Interval
from ctrl_rl_core.io.checked_yaml import read_yaml
from ctrl_rl_core.io.file_checks import FileError, first_error, raise_as, short_path, short_repr
from ctrl_rl_core.systems.registry import find_model
from ctrl_rl_core.tasks.option_tasks import ToolDelivery, WaterFilling
from ctrl_rl_core.tasks.schema.movers import MOST_MOVERS, MoverSpec
from ctrl_rl_core.tasks.schema.optimal_control import GridSpec, OptimalControlSpec
from ctrl_rl_core.tasks.schema.parts import EpisodeSpec, RewardSpec, Several, TaskHeader
from ctrl_rl_core.tasks.schema.randomisation import CONDITIONS, Randomisation
from ctrl_rl_core.tasks.schema.robot import MODEL, LidarSpec, RobotSpec, named_robot, with_limits
from ctrl_rl_core.tasks.schema.system import SystemSpec
from ctrl_rl_core.tasks.schema.world import ArenaSpec, CorridorSpec, DoorwaySpec, MapSpec, ObstacleSpec, RegionSpec

FOLDER = FilePath(__file__).parent / "task_files"
_PROSE = {"about", "source", "differences"}
_YOUNG = {"map", "movers", "randomisation", "doorways"}
"""Parts added to tasks later: a task without them keeps its digest."""


class TaskError(CtrlRlError):
    """A task file is missing or invalid."""


class NavigationTask(TaskHeader):
    """A robot moves from a start set to a goal set in a plane, (x, y) or (x, z), among obstacles."""

    kind: Literal["navigation"]
    system: SystemSpec
    robot: RobotSpec
    arena: ArenaSpec | None = None
    corridor: CorridorSpec | None = None
    map: MapSpec | None = None
    doorways: DoorwaySpec | None = None
    start: RegionSpec
    goal: RegionSpec
    trap: RegionSpec | None = None
    obstacles: Several[ObstacleSpec] = ()
    movers: Several[MoverSpec] = Field(default=(), max_length=MOST_MOVERS)
    episode: EpisodeSpec
    rewards: RewardSpec
    lidar: LidarSpec
    grid: dict[str, GridSpec] = Field(default_factory=dict)
    optimal_control: OptimalControlSpec | None = None
    randomisation: Randomisation = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _of_the_robot(cls, value: Any, info: ValidationInfo) -> Any:
        """Fill in the robot's lidar if the task has none, and its limits for the word `robot` in bounds."""
        robot = named_robot(value.get("robot"), info) if isinstance(value, dict) else None
        if robot is None:
            return value
        out = dict(value)
        if "lidar" not in out and robot.lidar.spec is not None:
            out["lidar"] = robot.lidar.spec
        for part in ("system", "optimal_control"):
            if isinstance(out.get(part), dict) and isinstance(out[part].get("controls"), dict):
                out[part] = {**out[part], "controls": with_limits(out[part]["controls"], robot)}
        return out

    @model_validator(mode="after")
    def _one_place(self) -> NavigationTask:
        if [self.arena, self.corridor, self.map].count(None) != 2:
            raise ValueError("needs either 'arena', 'corridor' or 'map'")
        if self.map is not None and self.plane != "xy":
            raise ValueError("map: only a ground robot has one")
        if self.doorways is not None:
            if self.corridor is None:
                raise ValueError("doorways: only a corridor has them")
            if self.doorways.reach >= 0.5 * self.corridor.width_range.low:
                raise ValueError("doorways: width and offset do not fit into the narrowest corridor")
        rolling = [name for name in self.randomisation if CONDITIONS[name].wheels and self.plane != "xy"]
        if rolling:
            raise ValueError(f"randomisation.{rolling[0]}: a flying robot has no wheels")
        self._check_model()
        names = {"s", "lateral", "heading"} if self.corridor else set(self.system.build().state_names)
        for key in ("start", "goal", "trap"):
            region: RegionSpec | None = getattr(self, key)
            unknown = set() if region is None else set(region.intervals) - names
            if unknown:
                raise ValueError(f"{key}.{min(unknown)}: no such state component; there are {', '.join(sorted(names))}")
        return self

    def _check_model(self) -> None:
        """Reject a `MODEL` body whose state has no pose, or whose commands differ from its controls."""
        if self.robot.body != MODEL:
            return
        system = self.system.build()
        if not set(system.state_names) >= {"x", self.plane[1]}:
            raise ValueError(f"system.model: a body 'model' needs states x and y, or x and z; '{system.name}' has "
                             f"{', '.join(system.state_names)}")  # fmt: skip
        if tuple(self.robot.commands) != system.control_names or len(system.control_names) != 2:
            raise ValueError(f"robot.commands: are {', '.join(self.robot.commands)}, must be the two controls of "
                             f"'{system.name}': {', '.join(system.control_names)}")  # fmt: skip
        if self.corridor is not None:
            raise ValueError("robot.body: a 'model' drives in an arena or on a map, not in a corridor")

    @property
    def plane(self) -> str:
        """Coordinates of the plane: "xz" for a quadrotor, "xy" for a ground robot."""
        return "xz" if "z" in (state.name for state in find_model(self.system.model).states) else "xy"

    @property
    def observed_states(self) -> tuple[str, ...]:
        """Observed components of the robot's motion: the system's state, and in a corridor the speeds."""
        own = self.system.build().state_names
        return own if self.corridor is None else (*own, "v", "omega")

    @property
    def plane_bounds(self) -> dict[str, Interval]:
        """Bounds of the space within the walls, by coordinate [m]; for a corridor at its maximum width."""
        if self.arena is not None:
            return dict(zip(self.plane, self.arena.bounds, strict=True))
        if self.map is not None:
            return dict(zip(self.plane, self.map.bounds, strict=True))
        assert self.corridor is not None
        path, half = self.corridor.path, 0.5 * self.corridor.width_range.high
        points = path.pose(np.linspace(0.0, path.length, 1000))[:, :2]
        ends = zip(self.plane, points.min(axis=0) - half, points.max(axis=0) + half, strict=True)
        return {name: Interval(float(low), float(high)) for name, low, high in ends}

    def build_world(self, width: float | None = None, random: np.random.Generator | None = None) -> World:
        """Create walls and obstacles.

        Args:
            width: Free width of the corridor [m]; None for the nominal one.
            random: Random generator of doorway positions and widths; None for the midpoints of their ranges.

        Raises:
            TaskError: There is no corridor, or `width` is outside its range.
        """
        shapes = tuple(obstacle.shape for obstacle in self.obstacles)
        if self.corridor is None:
            if width is not None:
                raise TaskError(f"task '{self.name}' has no corridor: its width cannot be set")
            place = self.arena or self.map
            assert place is not None
            walls = place.walls() if isinstance(place, ArenaSpec) else place.walls
            return World(walls=walls, obstacles=shapes, path=None, width=None)
        width = self.corridor.width if width is None else width
        if width not in self.corridor.width_range:
            low, high = self.corridor.width_range
            raise TaskError(f"width {width:g} m: task '{self.name}' allows {low:g} to {high:g} m")
        if self.doorways is not None:
            shapes += tuple(self.doorways.partitions(self.corridor, width, random))
        return World(walls=self.corridor.walls(width), obstacles=shapes, path=self.corridor.path, width=width)


_KINDS = ("navigation", "tool_delivery", "water_filling")
Task = NavigationTask | ToolDelivery | WaterFilling
_READER: TypeAdapter[Task] = TypeAdapter(Annotated[Task, Discriminator("kind")])


def task_names() -> tuple[str, ...]:
    """Return the names of the tasks shipped with the suite."""
    return tuple(sorted(file.stem for file in FOLDER.glob("*.yaml")))


def task_file(name_or_path: str | FilePath) -> FilePath:
    """Return the file of a task by name, or the path unchanged.

    Raises:
        TaskError: The suite has no task of that name.
    """
    path = FilePath(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return path.expanduser()
    path = FOLDER / f"{name_or_path}.yaml"
    if str(name_or_path) not in task_names():
        raise TaskError(
            f"no task '{short_path(name_or_path)}': there are {', '.join(task_names())}, or give a .yaml file"
        )
    return path


def load_task(name_or_path: str | FilePath) -> Task:
    """Load a task by name or path.

    Raises:
        TaskError: The task does not exist, or its file is invalid; the message names file and key.
    """
    path = task_file(name_or_path)
    with raise_as(TaskError, path):
        content = read_yaml(path)
        try:
            task = _READER.validate_python(content, context={"folder": path.parent})
        except ValidationError as error:
            raise FileError(first_error(error, _KINDS)) from None
        if task.name != path.stem:
            raise FileError(f"name: is {short_repr(task.name)}, must be the file's name {short_repr(path.stem)}")
    return task


def load_navigation_task(name_or_path: str | FilePath) -> NavigationTask:
    """Load a task that must be a navigation task.

    Raises:
        TaskError: As for `load_task`, or the task is of another kind.
    """
    task = load_task(name_or_path)
    if not isinstance(task, NavigationTask):
        raise TaskError(f"task '{task.name}' is of kind '{task.kind}': a navigation task is needed here")
    return task


def task_digest(task: TaskHeader) -> str:
    """Return the SHA-256 (hex) of the task's content in SI units, independent of prose and file layout."""
    left_out: dict[str, Any] = dict.fromkeys(_PROSE | {name for name in _YOUNG if not getattr(task, name, None)}, True)
    if isinstance(task, NavigationTask) and task.robot.footprint is None:
        left_out["robot"] = {"footprint"}
    if isinstance(task, NavigationTask) and not task.system.states:  # compatible with digests that predate this key
        left_out["system"] = {"states"}
    if isinstance(task, NavigationTask) and task.corridor is not None and not task.corridor.openings:  # the same
        left_out["corridor"] = {"openings"}
    content = task.model_dump_json(exclude=left_out)
    if isinstance(task, NavigationTask) and task.robot.robot is not None and "/" in task.robot.body:
        # A custom robot counts by its values, independently of the location of its file.
        content = content.replace(json.dumps(task.robot.body), json.dumps(task.robot.robot.digest), 1)
    return hashlib.sha256(content.encode()).hexdigest()
