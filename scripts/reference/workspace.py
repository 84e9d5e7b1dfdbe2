"""The workspace's packages, and the executables that they install."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = sorted(file.parent.name for file in ROOT.glob("*/package.xml"))


class Executable(NamedTuple):
    """Entry of a package's `console_scripts`.

    Attributes:
        package: Name of the package.
        name: Word after `ros2 run PACKAGE`.
        module: Module of the function that is called.
        function: Name of that function.
    """

    package: str
    name: str
    module: str
    function: str


def executables() -> Iterator[Executable]:
    """Yield all executables, by package and name."""
    for package in PACKAGES:
        file = ROOT / package / "setup.py"
        if not file.exists():
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Dict):
                for key, scripts in zip(node.keys, node.values, strict=True):
                    if isinstance(key, ast.Constant) and key.value == "console_scripts":
                        yield from (_executable(package, line) for line in ast.literal_eval(scripts))


def _executable(package: str, line: str) -> Executable:
    name, _, place = line.partition(" = ")
    module, _, function = place.partition(":")
    return Executable(package, name, module, function)
