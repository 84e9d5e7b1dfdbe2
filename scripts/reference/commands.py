"""The page of commands, with the `--help` of each."""

from __future__ import annotations

import os
import subprocess
from concurrent.futures import ThreadPoolExecutor
from itertools import groupby, pairwise

from ament_index_python.packages import get_package_prefix
from workspace import Executable, executables

_HEAD = """# Commands

This page shows the `--help` of each command. Wrong usage gives one line and exit code 2; a failure gives one line and
another non-zero code. Nodes are commands, too: [parameters](parameters.md) lists theirs in tables.
"""


class HelpError(Exception):
    """A command's `--help` fails."""


def command_page() -> str:
    """Return the page.

    Raises:
        HelpError: A command fails; the message contains its output.
    """
    found = list(executables())
    with ThreadPoolExecutor(2) as pool:
        texts = dict(zip(found, pool.map(help_of, found), strict=True))
    parts = [_HEAD]
    for package, members in groupby(found, key=lambda each: each.package):
        parts.append(f"## {package}\n")
        parts += [
            f"### ros2 run {package} {each.name}\n\n```text\n{texts[each]}\n```\n"
            for each in members
            if not each.module.endswith(".moved")
        ]
    return "\n".join(parts)


def help_of(executable: Executable) -> str:
    """Return what an executable prints for `--help`, subcommands included."""
    text = _run(executable, "--help")
    return "\n\n".join((text, *(_run(executable, name, "--help") for name in _subcommands(text))))


def _run(executable: Executable, *arguments: str) -> str:
    path = f"{get_package_prefix(executable.package)}/lib/{executable.package}/{executable.name}"
    environment = {**os.environ, "COLUMNS": "100", "NO_COLOR": "1", "TERM": "dumb"}
    answer = subprocess.run([path, *arguments], capture_output=True, text=True, env=environment, check=False)
    if answer.returncode:
        raise HelpError(f"{executable.name} {' '.join(arguments)} ended with {answer.returncode}: {answer.stderr}")
    return "\n".join(line.rstrip() for line in answer.stdout.strip().splitlines())


def _subcommands(text: str) -> list[str]:
    """Return the names in a usage's `{a,b,c}` if they are subcommands rather than an option's values."""
    words = text.split("\n\n", 1)[0].replace(",\n", ",").split()
    for before, word in pairwise(words):
        value = before.lstrip("[(").startswith("-") and not before.endswith("]")
        if word.startswith("{") and not value:
            return word.strip("{}").split(",")
    return []
