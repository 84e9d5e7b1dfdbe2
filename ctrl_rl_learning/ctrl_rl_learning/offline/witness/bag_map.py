"""An occupancy map from the scans of recorded drives at their poses, which becomes the world of a task.

What the bag saw decides, by log-odds; what it never saw is as the task's file says, and a wall where it lies behind a
wall that the file does not have.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from ctrl_rl_core.io import read_yaml
from ctrl_rl_core.navigation import FREE, OCCUPIED
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, binary_dilation, label

from ctrl_rl_core import NavigationTask, OccupancyMap, atomic_write, task_file
from ctrl_rl_learning.errors import LearningError
from ctrl_rl_learning.offline.witness.beams import FileWalls, compare
from ctrl_rl_learning.offline.witness.cells import Cells
from ctrl_rl_learning.offline.witness.record import DriveRecord

_CELL, _MARGIN = 0.025, 0.3
"""Side length of a cell, larger in very large places, and width of the rim around the file's area [m]."""
_GAP = 0.1
"""Width of gaps in a new wall that are closed [m]: beams are few far away."""
_HIT, _PASS = 0.85, -0.4
"""Log-odds of a wall for a beam that ends in a cell, and for one that passes through it."""
_REFUTED, _FEWEST_SEEN = 0.3, 10
"""Share of the seen cells of a file's obstacle that must be free for it to be gone, and their least number."""
_EIGHT = np.ones((3, 3), np.bool_)
_LEFT_OUT = ("arena", "corridor", "obstacles", "doorways", "map")


@dataclass(frozen=True)
class MapFromBag:
    """A map from scans.

    Attributes:
        map: Free and occupied cells.
        seen: Fraction of its cells that beams have crossed or hit.
        changed: Number of cells in which it differs from the file.
    """

    map: OccupancyMap
    seen: float
    changed: int


def map_from_record(record: DriveRecord, task: NavigationTask) -> MapFromBag:
    """Return the map of what drives of a task saw, over the area of its file.

    Raises:
        LearningError: The task's start and goal are stretches of a corridor, or nothing on the floor was seen.
    """
    if task.corridor is not None:
        raise LearningError(
            f"--map-from-bag: start and goal of task '{task.name}' are stretches of its corridor, of which a map knows "
            "none: fix 'corridor' in its file"
        )
    if task.plane != "xy" or not record.sightings:
        raise LearningError(f"--map-from-bag: the bags of task '{task.name}' show no walls on a floor")
    sides = task.plane_bounds.values()
    grid = Cells.around(np.array([side.low for side in sides]), np.array([side.high for side in sides]), _MARGIN, _CELL)
    beams = compare(record.sightings, FileWalls(task))
    echoes = beams.rows(beams.echoes)
    # What ended off the grid would count for the cells at its edge.
    inside = ((echoes.ends > grid.corner) & (echoes.ends < grid.far_corner)).all(axis=1)
    hits, passes = grid.count(echoes.ends[inside]), grid.passes(beams)
    odds = _HIT * hits + _PASS * passes
    seen = (hits + passes) > 0
    middles = grid.places(np.arange(seen.size)).reshape(*grid.shape, 2)
    walls = task.build_world().signed_distance(middles) < 0.5 * grid.resolution
    occupied = seen & (odds > 0.0)
    free = seen & ~occupied
    occupied |= ~seen & walls & ~_refuted(walls, free, seen)
    occupied |= _behind_new_walls(occupied, free, walls, max(1, round(0.5 * _GAP / grid.resolution)))
    cells = np.where(occupied, OCCUPIED, FREE).astype(np.int8)
    changed = int((occupied != walls).sum())
    x, y = grid.corner.tolist()
    return MapFromBag(OccupancyMap(cells, grid.resolution, (x, y, 0.0)), float(seen.mean()), changed)


def _refuted(walls: NDArray[np.bool_], free: NDArray[np.bool_], seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the cells of the file's walls of which much is seen free: what of them nobody saw is gone, too."""
    names, count = label(walls, _EIGHT)
    every = np.bincount(names[seen & walls], minlength=count + 1)
    gone = np.bincount(names[free & walls], minlength=count + 1)
    refuted = (every >= _FEWEST_SEEN) & (gone >= _REFUTED * every)
    refuted[0] = False
    return np.asarray(refuted[names])


def _behind_new_walls(
    occupied: NDArray[np.bool_], free: NDArray[np.bool_], walls: NDArray[np.bool_], gap: int
) -> NDArray[np.bool_]:
    """Return cells that nobody saw and that lie behind a wall which the file does not have; its gaps are closed.

    Args:
        occupied: Walls so far (rows, columns).
        free: Cells that beams passed through.
        walls: Walls of the file.
        gap: Half the width of the gaps that are closed [cells].
    """
    new = occupied & ~binary_dilation(walls, iterations=gap)
    closed = binary_closing(new, _EIGHT, iterations=gap) & ~free
    hidden = ~occupied & ~closed & ~free & ~binary_dilation(free, _EIGHT)
    names, _ = label(hidden)
    touched = np.unique(names[binary_dilation(new | closed, _EIGHT, iterations=gap) & hidden])
    return np.asarray(closed | np.isin(names, touched[touched > 0]))


def task_with_map(found: MapFromBag, task: NavigationTask, source: str, folder: Path, bags: str) -> Path:
    """Write a task whose world is a map from recorded drives, and that map, into a folder; return the task's file.

    Args:
        found: The map.
        task: Task whose start, goal, robot and rewards it keeps.
        source: Name or file of that task.
        folder: Folder of the two files.
        bags: Names of the bags, for the file's `source`.

    Raises:
        OSError: A file cannot be written.
    """
    name = task.name if task.name.endswith("_map") else f"{task.name}_map"
    folder.mkdir(parents=True, exist_ok=True)
    found.map.save(folder / f"{name}_walls.yaml")
    content: dict[str, Any] = {key: part for key, part in read_yaml(task_file(source)).items() if key not in _LEFT_OUT}
    content["name"], content["map"] = name, {"file": f"{name}_walls.yaml"}
    content["source"] = f"{task.source}; its walls by the scans of {bags}"
    content["robot"] = {**content["robot"], "body": task.robot.body}  # a file of one's own by its whole path
    atomic_write(folder / f"{name}.yaml", yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=120))
    return task_file(folder / f"{name}.yaml")
