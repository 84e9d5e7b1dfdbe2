"""Command-line tools: options parsed from a dataclass, and one-line errors.

A command calls `parse_options` with a dataclass whose docstrings become its help, then `run_command`.
"""

from __future__ import annotations

import dataclasses
import math
import os
import re
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypeVar, overload

import tyro
from tyro._errors import ParseErrorEvent, on_parse_error
from tyro.constructors import PrimitiveConstructorSpec

from ctrl_rl_core.entry import run_command as run_command
from ctrl_rl_core.entry import what_to_install as what_to_install
from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.old_names import with_new_names
from ctrl_rl_core.refusals import reason_of

EXIT_USAGE = 2
"""Exit code of a refused command line."""
_Options = TypeVar("_Options")


class CommandError(CtrlRlError):
    """An option has an invalid value."""


@overload
def parse_options(
    program: str, kind: type[_Options], arguments: Sequence[str] | None = None, epilog: str = ""
) -> _Options: ...
@overload
def parse_options(program: str, kind: Any, arguments: Sequence[str] | None = None, epilog: str = "") -> Any: ...
def parse_options(program: str, kind: Any, arguments: Sequence[str] | None = None, epilog: str = "") -> Any:
    """Parse the options of a command; `--help` prints the help and exits with 0.

    Args:
        program: Name of the command in messages.
        kind: Dataclass of the options. Its docstring describes the command, its fields' docstrings the options.
            For a command with subcommands, the union of their dataclasses, each annotated with
            `tyro.conf.subcommand(name)`.
        arguments: Command-line arguments; `sys.argv[1:]` by default.
        epilog: Text below the description in `--help`; for a union the whole description.

    Raises:
        SystemExit: With code 2 after a one-line error, or with code 0 after `--help`.
    """
    own = (kind.__doc__ or "").strip() if isinstance(kind, type) else ""
    description = "\n\n".join(filter(None, (own, epilog)))
    try:
        with on_parse_error(_refuse):
            options = tyro.cli(
                kind,
                prog=program,
                description=description,
                args=arguments,
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
            )
            _refuse_empty(options)
            return options
    except CommandError as error:
        print(f"{program}: {error}; see {program} --help", file=sys.stderr)
        raise SystemExit(EXIT_USAGE) from None


def _refuse_empty(options: Any) -> None:
    """Refuse a required list without an element, which tyro accepts."""
    for field in dataclasses.fields(options) if dataclasses.is_dataclass(options) else ():
        required = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        if required and getattr(options, field.name) == ():
            raise CommandError(f"missing {field.name}")


def _refuse(event: ParseErrorEvent) -> None:
    reason = reason_of(event)
    if reason:
        raise CommandError(reason)


def checked(
    parse: Callable[[str], Any], metavar: str, show: Callable[[Any], str] = str
) -> PrimitiveConstructorSpec[Any]:
    """Return a tyro reader for an option with one argument, for use in `Annotated`.

    Args:
        parse: Converts the argument to the value, or raises ValueError with the reason.
        metavar: Placeholder of the argument in `--help`.
        show: Converts a default back to text for `--help`.
    """
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=metavar,
        instance_from_str=lambda words: parse(words[0]),
        is_instance=lambda value: value is not None,
        str_from_instance=lambda value: [show(value)],
    )


def checked_list(
    parse: Callable[[str], Any], metavar: str, show: Callable[[Any], str] = str
) -> PrimitiveConstructorSpec[Any]:
    """Like `checked`, for an option with several arguments; the value is a tuple."""
    return PrimitiveConstructorSpec(
        nargs="*",
        metavar=f"[{metavar} ...]",
        instance_from_str=lambda words: tuple(parse(word) for word in words),
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda value: [show(each) for each in value],
    )


def one_of(names: Collection[str]) -> Any:
    """Return a tyro reader for an option that accepts one of these choices, for use in `Annotated`."""
    return checked(_choice(names), f"{{{','.join(names)}}}")


def some_of(names: Collection[str]) -> Any:
    """Return a tyro reader for an option that accepts any number of these choices, for use in `Annotated`."""
    return checked_list(_choice(names), f"{{{','.join(names)}}}")


def _choice(names: Collection[str]) -> Callable[[str], str]:
    def parse(text: str) -> str:
        if text not in names:
            raise ValueError(f"{text}: choose from {', '.join(names)}")
        return text

    return parse


def name_and_value(text: str) -> tuple[str, str]:
    """Split a NAME=VALUE argument into its two parts.

    Raises:
        ValueError: A part is missing.
    """
    name, _, value = text.partition("=")
    if not (name and value):
        raise ValueError(f"'{text}' must be NAME=VALUE")
    return name, value


def at_least(least: int) -> Any:
    """Return the type of an integer option with the lower bound `least`."""

    def parse(text: str) -> int:
        value = int(text) if re.fullmatch(r"[+-]?\d{1,18}", text) else None
        if value is None or value < least:
            raise ValueError(f"must be a whole number of at least {least}, not {text}")
        return value

    return Annotated[int, checked(parse, "INT")]


if TYPE_CHECKING:
    Positive: TypeAlias = int
    NotNegative: TypeAlias = int
else:
    Positive, NotNegative = at_least(1), at_least(0)


def finite_number(text: str) -> float:
    """Parse a finite number.

    Raises:
        ValueError: The text is not a finite number.
    """
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"'{text}' is not a finite number")
    return number


FiniteNumber = Annotated[float, checked(finite_number, "NUMBER")]
"""An option that is a finite number."""


def not_negative_number(text: str) -> float:
    """Parse a finite number >= 0.

    Raises:
        ValueError: The text is not a finite number, or the number is negative.
    """
    number = finite_number(text)
    if number < 0.0:
        raise ValueError(f"'{text}' is below 0")
    return number


OptionalNotNegativeNumber = Annotated[float | None, checked(not_negative_number, "NUMBER")]
"""An option that is a finite number >= 0, or absent."""


def file_to_write(text: str) -> Path:
    """Parse the path of a file to write.

    Raises:
        ValueError: The path is a folder, or its parent folder cannot be created or written to.
    """
    path = Path(text)
    if path.is_dir():
        raise ValueError(f"{path} is a folder: name a file in it")
    folder_to_write(str(path.parent))
    return path


def folder_to_write(text: str) -> Path:
    """Parse the path of an output folder, which may not exist yet.

    Raises:
        ValueError: The folder cannot be created or written to.
    """
    path = Path(text)
    nearest = next(each for each in (path, *path.parents) if each.exists())
    if not nearest.is_dir():
        raise ValueError(f"{nearest} is a file: name a folder")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise ValueError(f"{nearest} may not be written to")
    return path


FileToWrite = Annotated[Path, checked(file_to_write, "FILE")]
"""An option that names a file to write."""
OptionalFileToWrite = Annotated[Path | None, checked(file_to_write, "FILE")]
"""An optional file to write."""
FolderToWrite = Annotated[Path, checked(folder_to_write, "FOLDER")]
OptionalFolderToWrite = Annotated[Path | None, checked(folder_to_write, "FOLDER")]
"""An optional folder to write to."""


def make_command(
    program: str,
    kind: type[_Options],
    work: Callable[[_Options], int],
    epilog: str = "",
    renamed: Mapping[str, str] | None = None,
) -> Callable[..., int]:
    """Return a command: a function that takes command-line arguments and returns the exit code.

    The arguments default to those of the process.

    Args:
        program: Name of the command in messages.
        kind: Dataclass of its options, see `parse_options`.
        work: Does the work and returns the exit code.
        epilog: Text below the description in `--help`.
        renamed: Maps old option names to current ones, see `with_new_names`.
    """

    def command(arguments: Sequence[str] | None = None) -> int:
        words = with_new_names(program, arguments, renamed) if renamed else arguments
        options = parse_options(program, kind, words, epilog)
        return run_command(program, lambda: work(options))

    return command
