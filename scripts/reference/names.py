"""The page of names: the public names of each package and subpackage, read from the stubs that export them."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from workspace import PACKAGES, ROOT

_HEAD = """# Names of the packages

This page lists the public names of each package and subpackage; `dir()` lists the same. A name is imported when it is
first used. [The Python API](../api.md) has the few names that most programs need.
"""


def names_page() -> str:
    """Return the page, with a table for each package and each subpackage that exports names."""
    return "\n".join([_HEAD, *(_section(face) for package in PACKAGES for face in faces(package))])


def faces(package: str) -> list[str]:
    """Return the dotted names of a package and of its subpackages that export names."""
    stubs = sorted((ROOT / package / package).rglob("__init__.pyi"))
    return [".".join(stub.relative_to(ROOT).parts[1:-1]) for stub in stubs]


def names_of(face: str) -> dict[str, str]:
    """Return the names that a package exports, each with a description in one line."""
    return {name: _about(face, name) for name in sorted(_imports(face))}


def _section(face: str) -> str:
    rows = [f"| `{name}` | {about} |".replace("  |", " |") for name, about in names_of(face).items()]
    about = ast.get_docstring(_tree(_file(face).with_suffix(".py"))) or ""
    level = "#" * (2 + (1 if "." in face else 0))
    return "\n".join([f"{level} {face}\n", f"{about}\n", "| name | description |", "|---|---|", *rows, ""])


def _imports(module: str) -> dict[str, tuple[str, str]]:
    """Return the names that a module imports from the workspace, each with its source module and name."""
    found = {}
    for node in _tree(_file(module)).body:
        if isinstance(node, ast.ImportFrom) and node.module:
            source = f"{module}.{node.module}" if node.level else node.module
            found |= {alias.asname or alias.name: (source, alias.name) for alias in node.names}
    return found


def _about(module: str, name: str) -> str:
    """Return the docstring's first line of a class, function or constant; empty if there is none."""
    body = _tree(_file(module)).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name and ast.get_docstring(node):
            return (ast.get_docstring(node) or "").partition("\n")[0].replace("|", "\\|")
        if name in _assigned(node) and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            return " ".join(str(after.value.value).split()).replace("|", "\\|")
    source = _imports(module).get(name)
    return _about(*source) if source else ""


def _assigned(node: ast.stmt) -> set[str]:
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return {each.id for target in targets for each in ast.walk(target) if isinstance(each, ast.Name)}


def _file(module: str) -> Path:
    """Return the file of a module; for a package its stub, or else its `__init__.py`."""
    place = ROOT / module.split(".")[0] / Path(*module.split("."))
    files = (place / "__init__.pyi", place / "__init__.py", place.with_suffix(".py"))
    return next(file for file in files if file.exists())


@cache
def _tree(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))
