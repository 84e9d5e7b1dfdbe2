"""What error messages advise: the commands and options that they name, and the executables that can come to say so."""

import ast
import re
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

from pages import ROOT

sys.path.append(str(ROOT / "scripts" / "reference"))

from workspace import PACKAGES, Executable, executables

_RUN = re.compile(r"ros2 run (\w+) (\w+)([^`'\n),;]*)")
_QUOTED = re.compile(r"`([a-z_]+(?: [^`]+)?)`|'(oc [a-z]+)'")
_OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*[a-z]")
_ELSEWHERE = ("make ", "ray ", "ros2 bag ", "rosbags-convert ", "git ", "apt ", "pip ")
"""Tools that are not this workspace's."""


class Advice(NamedTuple):
    """One error message.

    Attributes:
        module: Module that has it.
        line: Line in the module.
        text: Its words; `{}` for what is filled in.
    """

    module: str
    line: int
    text: str

    def commands(self) -> Iterator[tuple[str, tuple[str, ...], set[str]]]:
        """Yield package (or nothing), executable and what follows it, and options, of each command that it names."""
        for package, name, more in _RUN.findall(self.text):
            yield package, (name, *_plain(more)), set(_OPTION.findall(more))
        for backticks, quotes in _QUOTED.findall(self.text):
            said = backticks or quotes
            if not said.startswith(("ros2 run ", *_ELSEWHERE)):
                yield "", tuple(_plain(said)), set(_OPTION.findall(said))

    def options(self) -> set[str]:
        """Return the options that it names on their own."""
        return set(_OPTION.findall(_QUOTED.sub("", _RUN.sub("", self.text)))) if not _foreign(self.text) else set()


def _foreign(text: str) -> bool:
    return any(tool in text for tool in _ELSEWHERE)


def _plain(words: str) -> list[str]:
    """Return the words before the first option."""
    return re.split(r"\s(?=--|\{|-)", f" {words}", maxsplit=1)[0].split()


@cache
def modules() -> dict[str, Path]:
    """Return the files of all modules of the workspace, by name."""
    out = {}
    for package in PACKAGES:
        for file in (ROOT / package / package).rglob("*.py"):
            parts = file.relative_to(ROOT / package).with_suffix("").parts
            out[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return out


def advices() -> Iterator[Advice]:
    """Yield each text of the code that names a command or an option, docstrings and single words apart."""
    for module, file in modules().items():
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for line, text in _texts(tree):
            advice = Advice(module, line, text)
            if " " in text and (advice.options() or any(True for _ in advice.commands())):
                yield advice


def _texts(node: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and words of each string that is no docstring, with {} for what is filled in."""
    if isinstance(node, ast.JoinedStr):
        yield node.lineno, "".join(_part(each) for each in node.values)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.lineno, node.value
    elif not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
        for child in ast.iter_child_nodes(node):
            yield from _texts(child)


def _part(node: ast.expr) -> str:
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else "{}"


@cache
def imports(module: str) -> frozenset[str]:
    """Return the modules that one imports, at its top or in a function, faces followed to where a name is defined."""
    out = set()
    for node in ast.walk(ast.parse(modules()[module].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            out |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            source = node.module if not node.level else _absolute(module, node)
            for alias in node.names:
                out |= _defined(source, alias.name)
    return frozenset(out & set(modules()))


def _absolute(module: str, node: ast.ImportFrom) -> str:
    parts = module.split(".") if modules()[module].name == "__init__.py" else module.split(".")[:-1]
    return ".".join((*parts[: len(parts) - node.level + 1], node.module or ""))


def _defined(source: str, name: str) -> set[str]:
    """Return where a name comes from: a module, or through the stub of a face."""
    if f"{source}.{name}" in modules():
        return {f"{source}.{name}"}
    file = modules().get(source)
    stub = file.with_suffix(".pyi") if file is not None else None
    if stub is not None and stub.exists():
        for line in ast.parse(stub.read_text(encoding="utf-8")).body:
            if isinstance(line, ast.ImportFrom) and any(alias.asname == name for alias in line.names):
                return {source, *_defined(f"{source}.{line.module}", name)}
    return {source}


@cache
def reached(module: str) -> frozenset[str]:
    """Return the modules that run where one is imported or called."""
    found, ahead = {module}, [module]
    while ahead:
        new = imports(ahead.pop()) - found
        found |= new
        ahead += new
    return frozenset(found)


def commands_that_reach(module: str) -> list[Executable]:
    """Return the executables that can come to a module."""
    return [each for each in executables() if each.module in modules() and module in reached(each.module)]
