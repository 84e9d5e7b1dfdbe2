"""Old names of commands and options: they still work and say the new ones."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence


def note_old_name(program: str, old: str, new: str) -> None:
    """Say that an old name was used, and what to use now."""
    print(f"{program}: {old} still works; its new name is {new}", file=sys.stderr)


def with_new_names(program: str, arguments: Sequence[str] | None, renamed: Mapping[str, str]) -> list[str]:
    """Return the words of a command line with the present names of options, and say which were old.

    Args:
        program: Name of the command in messages.
        arguments: Words of the command line; those of the process unless given.
        renamed: Present names of options by their old ones.
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
    """Return a command under an old name, which says the new one."""

    def old_command(arguments: Sequence[str] | None = None) -> int:
        note_old_name(program, program, new)
        return command(arguments)

    return old_command
