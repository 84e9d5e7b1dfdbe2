"""Walls, obstacles and sets of states in a task file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, PrivateAttr, ValidationInfo, computed_field, field_validator, model_validator

from ctrl_rl_core.geometry.shapes import Arc, ArcPath, Box, Disc, Opening, Shape, frame_walls
from ctrl_rl_core.geometry.units import Angle, Interval, Length, LengthInterval, Point, PositiveLength
from ctrl_rl_core.navigation.occupancy_map import MapError, OccupancyMap
from ctrl_rl_core.tasks.regions import Region
from ctrl_rl_core.tasks.schema.parts import Part, Several, interval_map
from ctrl_rl_core.tasks.schema.system import STATE_UNITS


class ArenaSpec(Part):
    """The rectangle that confines the robot (x, and y or z), surrounded by walls of the given thickness."""

    x: LengthInterval
    y: LengthInterval | None = None
    z: LengthInterval | None = None
    wall_thickness: PositiveLength

    @model_validator(mode="after")
    def _two_axes(self) -> ArenaSpec:
        if (self.y is None) == (self.z is None):
            raise ValueError("needs 'x' and either 'y' or 'z'")
        return self

    @property
    def bounds(self) -> tuple[Interval, Interval]:
        """The two intervals of the plane [m]."""
        second = self.y if self.y is not None else self.z
        assert second is not None
        return self.x, second

    def walls(self) -> tuple[Box, ...]:
        """Return the four walls."""
        return frame_walls(*self.bounds, self.wall_thickness)


class StraightSpec(Part):
    """A straight path segment."""

    straight: PositiveLength

    def arc(self) -> Arc:
        """Return the segment as an arc."""
        return Arc(self.straight, 0.0)


class TurnSpec(Part):
    """A path segment that turns by an angle, positive to the left, at a radius."""

    turn: Angle
    radius: PositiveLength

    def arc(self) -> Arc:
        """Return the segment as an arc."""
        return Arc(abs(self.turn) * self.radius, math.copysign(1.0 / self.radius, self.turn))


class OpeningSpec(Part):
    """An opening in a wall of a corridor.

    Attributes:
        s: Part of the path beside which there is no wall [m].
        side: Side of the wall, seen along the path.
    """

    s: LengthInterval
    side: Literal["left", "right"]

    @field_validator("s")
    @classmethod
    def _wide(cls, value: Interval) -> Interval:
        if value.length <= 0.0:
            raise ValueError("must be wider than zero")
        return value


class CorridorSpec(Part):
    """Two walls along a path, closed behind the start and open at the end.

    The task's regions are in path coordinates: s along it [m], lateral to the left of it [m], heading
    relative to it [rad].

    Attributes:
        pieces: Segments of the path.
        width: Nominal free width between the walls [m].
        width_range: Free widths that an episode may draw [m].
        wall_thickness: Thickness of the walls [m].
        openings: Parts of the walls that are missing.
    """

    pieces: Several[StraightSpec | TurnSpec] = Field(min_length=1, max_length=1000)
    width: PositiveLength
    width_range: LengthInterval
    wall_thickness: PositiveLength
    openings: Several[OpeningSpec] = ()

    @model_validator(mode="after")
    def _fits(self) -> CorridorSpec:
        if self.width not in self.width_range:
            raise ValueError("width: lies outside width_range")
        self.walls(self.width_range.high)
        return self

    @property
    def path(self) -> ArcPath:
        """The centre line."""
        return ArcPath(tuple(piece.arc() for piece in self.pieces))

    def walls(self, width: float) -> tuple[Box, ...]:
        """Return the walls at a free width [m], including the wall behind the start."""
        cap = Box((-0.5 * self.wall_thickness, 0.0), (self.wall_thickness, width + 2 * self.wall_thickness))
        openings = [Opening(*each.s, 1.0 if each.side == "left" else -1.0) for each in self.openings]
        return (cap, *self.path.walls(width, self.wall_thickness, openings=openings))


class DoorwaySpec(Part):
    """Partitions across a corridor at equal distances, each with one doorway.

    Attributes:
        spacing: Distance along the path between partitions, and from its beginning to the first one [m].
        shift: Maximum random shift of a partition along the path, either way [m].
        width: Free width of a doorway, drawn for each [m].
        offset: Offset of a doorway's centre to the left of the path, drawn for each [m].
        thickness: Thickness of a partition [m].
    """

    spacing: PositiveLength
    shift: Length = 0.0
    width: LengthInterval
    offset: LengthInterval = Interval(0.0, 0.0)
    thickness: PositiveLength

    @model_validator(mode="after")
    def _fits(self) -> DoorwaySpec:
        if self.width.low <= 0.0:
            raise ValueError("width: must be more than zero")
        if not 0.0 <= self.shift <= 0.25 * self.spacing:
            raise ValueError("shift: must be between zero and a quarter of spacing")
        return self

    @property
    def reach(self) -> float:
        """Maximum distance of a doorway's side from the path [m]."""
        return max(-self.offset.low, self.offset.high) + 0.5 * self.width.high

    def count(self, corridor: CorridorSpec) -> int:
        """Return the number of partitions in a corridor."""
        return max(0, int(corridor.path.length / self.spacing + 0.5) - 1)

    def partition(self, corridor: CorridorSpec, width: float, number: int, shares: ArrayLike) -> tuple[Box, Box]:
        """Return the two boxes beside one doorway.

        Args:
            corridor: Corridor of the doorways.
            width: Free width of the corridor [m].
            number: Number of the partition along the path, from 0.
            shares: Place along the path, offset and free width (3,), each as a share of its range, 0 to 1.
        """
        path, outside = corridor.path, 0.5 * width + corridor.wall_thickness
        along, aside, wide = np.asarray(shares, dtype=float).tolist()
        s = (number + 1) * self.spacing + self.shift * (2.0 * along - 1.0)
        middle = self.offset.low + aside * self.offset.length
        half = 0.5 * (self.width.low + wide * self.width.length)
        x, y, heading = path.pose(s).tolist()

        def box(near: float, far: float) -> Box:
            lateral = 0.5 * (near + far)
            centre = (x - lateral * math.sin(heading), y + lateral * math.cos(heading))
            return Box(centre, (self.thickness, far - near), heading)

        return box(middle + half, outside), box(-outside, middle - half)

    def partitions(self, corridor: CorridorSpec, width: float, random: np.random.Generator | None) -> Iterator[Box]:
        """Yield two boxes per doorway.

        Args:
            corridor: Corridor of the doorways.
            width: Free width of the corridor [m].
            random: Random generator of positions and widths; None for the midpoints of their ranges.
        """
        for number in range(self.count(corridor)):
            shares = np.full(3, 0.5) if random is None else random.uniform(size=3)
            yield from self.partition(corridor, width, number, shares)


class MapSpec(Part):
    """A place given by its occupancy map, a YAML file as for map_server; occupied cells are walls.

    Attributes:
        file: Path of the YAML file, relative to the task file.
    """

    file: str = Field(exclude=True)
    _map: OccupancyMap = PrivateAttr()

    @field_validator("file")
    @classmethod
    def _beside_the_task(cls, value: str, info: ValidationInfo) -> str:
        folder = (info.context or {}).get("folder")
        return value if folder is None else str(folder / Path(value).expanduser())

    @model_validator(mode="after")
    def _readable(self) -> MapSpec:
        try:
            self._map = OccupancyMap.load(self.file)
        except MapError as error:
            raise ValueError(str(error)) from None
        return self

    @property
    def map(self) -> OccupancyMap:
        """The map."""
        return self._map

    @computed_field
    def content(self) -> str:
        """SHA-256 (hex) of the map's cells and pose, independent of the file's location."""
        place = repr((self.map.cells.shape, self.map.resolution, self.map.origin))
        return sha256(self.map.cells.tobytes() + place.encode()).hexdigest()

    @property
    def bounds(self) -> tuple[Interval, Interval]:
        """Minimum and maximum x and y of the map [m]."""
        rows, columns = self.map.cells.shape
        corners = self.map.cell_to_world((-0.5, -0.5, rows - 0.5, rows - 0.5), (-0.5, columns - 0.5) * 2)
        (left, bottom), (right, top) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
        return Interval(left, right), Interval(bottom, top)

    @cached_property
    def walls(self) -> tuple[Box, ...]:
        """Boxes that cover the occupied cells."""
        return self.map.boxes()


class BoxSpec(Part):
    """A box by centre and size."""

    centre: Point
    size: Point


class DiscSpec(Part):
    """A disc by centre and radius."""

    centre: Point
    radius: PositiveLength


class ObstacleSpec(Part):
    """A static obstacle: a box or a disc."""

    box: BoxSpec | None = None
    disc: DiscSpec | None = None

    @model_validator(mode="after")
    def _one(self) -> ObstacleSpec:
        if (self.box is None) == (self.disc is None):
            raise ValueError("needs either 'box' or 'disc'")
        return self

    @property
    def shape(self) -> Shape:
        """Geometry of the obstacle."""
        if self.box is not None:
            return Box(self.box.centre, self.box.size)
        assert self.disc is not None
        return Disc(self.disc.centre, self.disc.radius)


class RegionSpec(Part):
    """A set of states: intervals by state name, and optionally a disc of positions."""

    disc: DiscSpec | None = None
    intervals: Annotated[dict[str, Interval], interval_map(STATE_UNITS)] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _gather(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            raise ValueError("must be a mapping from state names to intervals")
        rest = {name: text for name, text in value.items() if name != "disc"}
        return {"intervals": rest} | ({"disc": value["disc"]} if "disc" in value else {})

    @property
    def region(self) -> Region:
        """The set of states."""
        disc = None if self.disc is None else Disc(self.disc.centre, self.disc.radius)
        return Region(self.intervals, disc)
