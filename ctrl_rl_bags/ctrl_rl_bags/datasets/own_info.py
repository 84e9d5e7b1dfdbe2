"""What an exported dataset says of itself beside what its format asks: the layout of its frames, and its bags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ctrl_rl_core.io.checked_json import parse_json
from ctrl_rl_core.io.file_checks import as_text, read_bytes

from ctrl_rl_bags.datasets.errors import LARGEST_INFO, DatasetError
from ctrl_rl_bags.datasets.frames import Layout

_KEY = "ctrl_rl"


def own_info(layout: Layout, sources: Sequence[str]) -> dict[str, Any]:
    """Return the part of a dataset's JSON that `read_own_info` reads; `sources` names the bags."""
    return {_KEY: {"layout": layout.model_dump(), "sources": sources}}


def read_own_info(file: Path) -> Mapping[str, Any]:
    """Return layout and sources from a dataset's JSON file.

    Raises:
        DatasetError: It has none.
    """
    content = parse_json(as_text(read_bytes(file, LARGEST_INFO)))
    own = content.get(_KEY) if isinstance(content, dict) else None
    if not isinstance(own, dict):
        raise DatasetError("was not written by `bag export`: it does not say what its frames are")
    return own
