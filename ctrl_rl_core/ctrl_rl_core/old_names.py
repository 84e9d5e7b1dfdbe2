"""Old names of commands and options; they still work, with a notice of the new names."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence


def note_old_name(program: str, old: str, new: str) -> None:
    """Print a notice that an old name was used, with its replacement."""
    print(f"{program}: {old} still works; its new name is {new}", file=sys.stderr)


def with_new_names(program: str, arguments: Sequence[str] | None, renamed: Mapping[str, str]) -> list[str]:
    """Replace old option names in a command line by current ones, and return the old names found.

    Args:
        program: Name of the command in messages.
        arguments: Command-line arguments; those of the process by default.
        renamed: Maps old option names to current ones.
    """
    out = []
    for word in sys.argv[1:] if arguments is None else arguments:
        name, equals, value = word.partition("=")
        if name in renamed:
            note_old_name(program, name, renamed[name])
            word = renamed[name] + equals + value
        out.append(word)
    return out


def make_old_command(program: str, new: str, command: Callable[..., int]) -> Callable[..., int]:
    """Return a command that runs under an old name and prints the new one."""

    def old_command(arguments: Sequence[str] | None = None) -> int:
        note_old_name(program, program, new)
        return command(arguments)

    return old_command
