"""Maps shipped with the package."""

from pathlib import Path

from ctrl_rl_core import OccupancyMap
from ctrl_rl_navigation.errors import NavigationError

FOLDER = Path(__file__).parent


def map_names() -> tuple[str, ...]:
    """Return the names of the shipped maps."""
    return tuple(sorted(file.stem for file in FOLDER.glob("*.yaml")))


def map_file(name_or_path: str | Path) -> Path:
    """Return the file of a map by name, or the path unchanged if it ends in .yaml.

    Raises:
        NavigationError: The map does not exist.
    """
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return path.expanduser()
    if str(name_or_path) not in map_names():
        raise NavigationError(f"no map '{name_or_path}': there are {', '.join(map_names())}, or give a .yaml file")
    return FOLDER / f"{name_or_path}.yaml"


def load_map(name_or_path: str | Path) -> OccupancyMap:
    """Load a map by name or file.

    Raises:
        NavigationError: The map does not exist.
        MapError: The file is missing or invalid.
    """
    return OccupancyMap.load(map_file(name_or_path))
