"""A map of free, occupied and unknown cells, from a map file or from nav_msgs/OccupancyGrid.

office = OccupancyMap.load("office.yaml")
office.clearance()[office.world_to_cell((1.0, 2.0))]
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.geometry.shapes import Box
from ctrl_rl_core.navigation.map_file import MapFileError, read_map, write_map
from ctrl_rl_core.sensing.pose import PoseError, planar, read_pose

if TYPE_CHECKING:
    from nav_msgs.msg import OccupancyGrid

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
"""Values of a cell, as in nav_msgs/OccupancyGrid."""
MOST_CELLS = 25_000_000
"""Maximum number of cells of a map: 250 m by 250 m at 5 cm."""
_FREE_UP_TO, _OCCUPIED_FROM = 25, 65
"""Occupancy percentages up to which a cell is free, and from which it is occupied."""
_RESOLUTION = (1e-3, 10.0)
_FARTHEST = 1e6
_LARGEST_TILT = 1e-3

Cells = NDArray[np.int8]


class MapError(CtrlRlError):
    """A map cannot be read or used; the message gives the reason."""


@dataclass(frozen=True, eq=False)
class OccupancyMap:
    """A grid of cells; row 0 lies at the origin, and rows increase along y, as in nav_msgs/OccupancyGrid.

    Attributes:
        cells: FREE, OCCUPIED or UNKNOWN (rows, columns), read-only.
        resolution: Side length of a cell [m].
        origin: Outer corner of cell (0, 0) and direction of the rows: x, y, yaw [m, m, rad].

    Raises:
        MapError: There are no or too many cells, or a number is not finite or out of range.
    """

    cells: Cells
    resolution: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        shape = self.cells.shape
        if len(shape) != 2 or not 0 < self.cells.size <= MOST_CELLS:
            raise MapError(f"a map of {' x '.join(map(str, shape))} cells: it must have 1 to {MOST_CELLS:,}")
        if not _RESOLUTION[0] <= self.resolution <= _RESOLUTION[1]:
            raise MapError(f"resolution {self.resolution}: must be {_RESOLUTION[0]:g} to {_RESOLUTION[1]:g} m")
        if not all(abs(number) <= _FARTHEST for number in self.origin):
            raise MapError(f"origin {self.origin}: must be three numbers within {_FARTHEST:g}")
        cells = np.array(self.cells, np.int8)  # own copy
        cells.flags.writeable = False
        object.__setattr__(self, "cells", cells)
        object.__setattr__(self, "resolution", float(self.resolution))
        object.__setattr__(self, "origin", tuple(map(float, self.origin)))

    def is_same(self, other: OccupancyMap) -> bool:
        """Return whether another map has the same cells at the same positions."""
        same = (self.resolution, self.origin) == (other.resolution, other.origin)
        return same and np.array_equal(self.cells, other.cells)

    @classmethod
    def from_percent(
        cls, percent: NDArray[np.integer], resolution: float, origin: tuple[float, float, float]
    ) -> OccupancyMap:
        """Create a map from occupancies (rows, columns): 0 to 100, or -1 for unknown; 25 to 65 also counts as unknown.

        Raises:
            MapError: As for the class, or an occupancy is invalid.
        """
        if percent.size and not (percent.min() >= UNKNOWN and percent.max() <= OCCUPIED):
            raise MapError(f"occupancies from {percent.min()} to {percent.max()}: must be -1 to 100")
        cells = np.full(percent.shape, UNKNOWN, np.int8)
        cells[(percent >= 0) & (percent <= _FREE_UP_TO)] = FREE
        cells[percent >= _OCCUPIED_FROM] = OCCUPIED
        return cls(cells, resolution, origin)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> OccupancyMap:
        """Read a map's YAML file and its image, as map_server does.

        Raises:
            MapError: A file is missing or invalid; the message names it.
        """
        try:
            return cls.from_percent(*read_map(path, MOST_CELLS))
        except MapFileError as error:
            raise MapError(str(error)) from None
        except MapError as error:
            raise MapError(f"{path}: {error}") from None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write NAME.yaml and NAME.pgm, each atomically.

        Raises:
            OSError: A file cannot be written; the error names it.
        """
        write_map(Path(path), self.cells, self.resolution, self.origin)

    @classmethod
    def from_message(cls, message: Any) -> OccupancyMap:
        """Create a map from a nav_msgs/OccupancyGrid, from rclpy or a bag.

        Raises:
            MapError: The message is inconsistent, or a number is out of range.
        """
        info, pose = message.info, message.info.origin
        rows, columns = int(info.height), int(info.width)
        try:
            origin = read_pose(pose.position, pose.orientation).tolist()
        except PoseError as error:
            raise MapError(f"the map's origin has {error}") from None
        if math.hypot(*origin[3:5]) > _LARGEST_TILT:
            raise MapError("the map's origin is tilted: it must lie in the x-y plane")
        if rows * columns != len(message.data):
            raise MapError(f"a map of {rows} x {columns} cells with {len(message.data)} values")
        percent = np.array(message.data, np.int8).reshape(rows, columns)
        x, y, yaw = planar(origin).tolist()
        return cls.from_percent(percent, float(info.resolution), (x, y, yaw))

    def to_message(self, stamp: Any, frame: str) -> OccupancyGrid:
        """Return the map as a message.

        Args:
            stamp: Time stamp, a builtin_interfaces/Time.
            frame: Frame of the origin.
        """
        from nav_msgs.msg import OccupancyGrid

        out = OccupancyGrid()
        out.header.stamp, out.header.frame_id = stamp, frame
        out.info.map_load_time, out.info.resolution = stamp, self.resolution
        out.info.height, out.info.width = self.cells.shape
        x, y, yaw = self.origin
        out.info.origin.position.x, out.info.origin.position.y = x, y
        out.info.origin.orientation.z, out.info.origin.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
        out.data.frombytes(self.cells.tobytes())
        return out

    @property
    def size(self) -> tuple[float, float]:
        """Side lengths along the columns and along the rows [m]."""
        rows, columns = self.cells.shape
        return columns * self.resolution, rows * self.resolution

    def to_grid(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return fractional rows and columns (..., 2) of points (..., 2) [m]; 0.0 is the centre of cell 0."""
        x, y, yaw = self.origin
        offset = np.asarray(points, np.float64) - (x, y)
        c, s = math.cos(yaw), math.sin(yaw)
        along, aside = c * offset[..., 0] + s * offset[..., 1], c * offset[..., 1] - s * offset[..., 0]
        return np.stack((aside, along), axis=-1) / self.resolution - 0.5

    def world_to_cell(self, points: ArrayLike) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows (...) and columns (...) of the cells that contain points (..., 2) [m], also off the map."""
        grid = np.floor(np.clip(self.to_grid(points) + 0.5, -1e9, 1e9)).astype(np.intp)
        return grid[..., 0], grid[..., 1]

    def cell_to_world(self, rows: ArrayLike, columns: ArrayLike) -> NDArray[np.float64]:
        """Return the centres (..., 2) of cells [m]."""
        x, y, yaw = self.origin
        along = (np.asarray(columns, np.float64) + 0.5) * self.resolution
        aside = (np.asarray(rows, np.float64) + 0.5) * self.resolution
        c, s = math.cos(yaw), math.sin(yaw)
        return np.stack((x + c * along - s * aside, y + s * along + c * aside), axis=-1)

    def at(self, points: ArrayLike) -> Cells:
        """Return the values (...) of the cells that contain points (..., 2) [m]; UNKNOWN outside the map."""
        rows, columns = self.world_to_cell(points)
        height, width = self.cells.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        out: Cells = np.where(inside, self.cells[np.where(inside, rows, 0), np.where(inside, columns, 0)], UNKNOWN)
        return out

    def clearance(self, unknown_is_free: bool = False) -> NDArray[np.float32]:
        """Return the distance from each cell's centre to the nearest blocked cell (rows, columns) [m].

        Occupied cells block; so do unknown cells and everything outside the map, unless `unknown_is_free`. A blocked
        cell counts as a disc of its width, so at a corner the distance is up to 0.2 cells too large.
        """
        blocked = self.cells == OCCUPIED
        if not unknown_is_free:
            blocked = np.pad(blocked | (self.cells == UNKNOWN), 1, constant_values=True)
        if not blocked.any():
            return np.full(self.cells.shape, np.inf, np.float32)
        from scipy.ndimage import distance_transform_edt  # slow import

        distance = np.maximum(distance_transform_edt(~blocked) - 0.5, 0.0) * self.resolution
        return (distance if unknown_is_free else distance[1:-1, 1:-1]).astype(np.float32)

    def boxes(self) -> tuple[Box, ...]:
        """Return non-overlapping rectangles that cover the occupied cells exactly, as obstacles of a task."""
        occupied = self.cells == OCCUPIED
        wide, high = _rectangles(occupied), _rectangles(occupied.T)
        sides = wide if len(wide) <= len(high) else [(left, right, bottom, top) for bottom, top, left, right in high]
        return tuple(self._box(*each) for each in sorted(sides))

    def _box(self, bottom: int, top: int, left: int, right: int) -> Box:
        centre = self.cell_to_world(0.5 * (bottom + top - 1), 0.5 * (left + right - 1))
        size = ((right - left) * self.resolution, (top - bottom) * self.resolution)
        return Box((float(centre[0]), float(centre[1])), size, self.origin[2])


def _rectangles(occupied: NDArray[np.bool_]) -> list[tuple[int, int, int, int]]:
    """Merge equal runs of cells in consecutive rows into rectangles: first row, end row, first column, end column."""
    begun: dict[tuple[int, int], int] = {}  # maps a run's first and end column to the row in which it started
    out = []
    for row, cells in enumerate((*occupied, np.zeros(occupied.shape[1], np.bool_))):
        edges = np.flatnonzero(np.diff(cells, prepend=False, append=False)).tolist()
        runs = set(zip(edges[::2], edges[1::2], strict=True))
        out += [(begun.pop(run), row, *run) for run in begun.keys() - runs]
        for run in runs:
            begun.setdefault(run, row)
    return out
