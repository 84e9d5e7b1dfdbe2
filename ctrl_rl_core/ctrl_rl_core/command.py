"""Commands: options from a dataclass, and an end with the work done, one clear line of error, or an interruption.

A command calls `parse_options` with a dataclass whose docstrings are its help, then `run_command`.
"""

from __future__ import annotations

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
"""A command line is refused."""
_Options = TypeVar("_Options")


class CommandError(CtrlRlError):
    """An option has a value that does not serve."""


@overload
def parse_options(
    program: str, kind: type[_Options], arguments: Sequence[str] | None = None, epilog: str = ""
) -> _Options: ...
@overload
def parse_options(program: str, kind: Any, arguments: Sequence[str] | None = None, epilog: str = "") -> Any: ...
def parse_options(program: str, kind: Any, arguments: Sequence[str] | None = None, epilog: str = "") -> Any:
    """Return the options of a command; `--help` prints them and exits with 0.

    Args:
        program: Name of the command in messages.
        kind: Dataclass of the options. Its docstring describes the command, its fields' docstrings the options.
            For a command with subcommands, the union of their dataclasses, each annotated with
            `tyro.conf.subcommand(name)`.
        arguments: Words of the command line; those of the process unless given.
        epilog: Text below the description in `--help`; for a union the whole description.

    Raises:
        SystemExit: With 2 after one line that says what is wrong, or with 0 after `--help`.
    """
    own = (kind.__doc__ or "").strip() if isinstance(kind, type) else ""
    description = "\n\n".join(filter(None, (own, epilog)))
    try:
        with on_parse_error(_refuse):
            return tyro.cli(
                kind,
                prog=program,
                description=description,
                args=arguments,
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
            )
    except CommandError as error:
        print(f"{program}: {error}; see {program} --help", file=sys.stderr)
        raise SystemExit(EXIT_USAGE) from None


def _refuse(event: ParseErrorEvent) -> None:
    reason = reason_of(event)
    if reason:
        raise CommandError(reason)


def checked(
    parse: Callable[[str], Any], metavar: str, show: Callable[[Any], str] = str
) -> PrimitiveConstructorSpec[Any]:
    """Return the reader of an option's one word, for use in `Annotated`.

    Args:
        parse: Returns the value of a word, or raises ValueError with the reason of a refusal.
        metavar: Placeholder of the word in `--help`.
        show: Returns the word of a default, for `--help`.
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
    """Return the reader of an option's words as a tuple; the arguments are those of `checked`."""
    return PrimitiveConstructorSpec(
        nargs="*",
        metavar=f"[{metavar} ...]",
        instance_from_str=lambda words: tuple(parse(word) for word in words),
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda value: [show(each) for each in value],
    )


def one_of(names: Collection[str]) -> Any:
    """Return how an option is read that takes one of these words, for use in `Annotated`."""
    return checked(_choice(names), f"{{{','.join(names)}}}")


def some_of(names: Collection[str]) -> Any:
    """Return how an option is read that takes any number of these words, for use in `Annotated`."""
    return checked_list(_choice(names), f"{{{','.join(names)}}}")


def _choice(names: Collection[str]) -> Callable[[str], str]:
    def parse(text: str) -> str:
        if text not in names:
            raise ValueError(f"{text}: choose from {', '.join(names)}")
        return text

    return parse


def name_and_value(text: str) -> tuple[str, str]:
    """Return both parts of a word NAME=VALUE.

    Raises:
        ValueError: A part is missing.
    """
    name, _, value = text.partition("=")
    if not (name and value):
        raise ValueError(f"'{text}' must be NAME=VALUE")
    return name, value


def at_least(least: int) -> Any:
    """Return the type of an option that is a whole number of at least `least`."""

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
    """Return the number of an option's word.

    Raises:
        ValueError: It is no number, or not a finite one.
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
    """Return the number of an option's word.

    Raises:
        ValueError: It is no number, not a finite one, or below 0.
    """
    number = finite_number(text)
    if number < 0.0:
        raise ValueError(f"'{text}' is below 0")
    return number


OptionalNotNegativeNumber = Annotated[float | None, checked(not_negative_number, "NUMBER")]
"""An option that is a finite number of at least 0, or absent."""


def file_to_write(text: str) -> Path:
    """Return an option's file that will be written.

    Raises:
        ValueError: It is a folder, or its folder cannot be there or be written to.
    """
    path = Path(text)
    if path.is_dir():
        raise ValueError(f"{path} is a folder: name a file in it")
    folder_to_write(str(path.parent))
    return path


def folder_to_write(text: str) -> Path:
    """Return an option's folder that files will be written to; it need not be there yet.

    Raises:
        ValueError: It cannot be there or be written to.
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
"""The same, where the option may be left out."""
FolderToWrite = Annotated[Path, checked(folder_to_write, "FOLDER")]
OptionalFolderToWrite = Annotated[Path | None, checked(folder_to_write, "FOLDER")]
"""An option that names a folder to write to."""


def make_command(
    program: str,
    kind: type[_Options],
    work: Callable[[_Options], int],
    epilog: str = "",
    renamed: Mapping[str, str] | None = None,
) -> Callable[..., int]:
    """Return a command: a function of the words of its line (the process's unless given) that returns the exit code.

    Args:
        program: Name of the command in messages.
        kind: Dataclass of its options, see `parse_options`.
        work: Does the work and returns the exit code.
        epilog: Text below the description in `--help`.
        renamed: Present names of options by their old ones, see `with_new_names`.
    """

    def command(arguments: Sequence[str] | None = None) -> int:
        words = with_new_names(program, arguments, renamed) if renamed else arguments
        options = parse_options(program, kind, words, epilog)
        return run_command(program, lambda: work(options))

    return command
