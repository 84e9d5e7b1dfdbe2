"""Entry points offered by installed packages, by group and name."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar

from ctrl_rl_core.errors import CtrlRlError, one_line

Part = TypeVar("Part")


def find_plugins(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group, sorted by name."""
    return {entry.name: entry for entry in sorted(entry_points(group=group))}


def load_plugin(entry: EntryPoint, kind: type[Part], noun: str, error: type[CtrlRlError]) -> Part:
    """Load the object that an entry point names.

    Args:
        entry: Entry point of an installed package.
        kind: Required class of the object.
        noun: Noun for the object in messages.
        error: Error class to raise.

    Raises:
        CtrlRlError: The package cannot be imported, or its object is of another class; raised as `error`.
    """
    offered = f"{noun} '{entry.name}' ({entry.value})"
    try:
        part = entry.load()
    except Exception as fault:  # importing another package may raise anything
        raise error(f"{offered} cannot be loaded: {one_line(fault)}") from None
    if not isinstance(part, kind):
        raise error(f"{offered} is no {kind.__module__}.{kind.__name__}")
    return part
