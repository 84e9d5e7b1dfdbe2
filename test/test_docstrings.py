"""Entries of Args, Attributes and Returns say what the thing is.

`python test/test_docstrings.py PACKAGE...` lists the entries that do not: those that begin with "of", "what", "how" or
"see", or that have two words or fewer. `ALLOWED` holds how many a package still has: it only goes down.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ALLOWED = {
    "ctrl_rl_bags": 0,
    "ctrl_rl_bringup": 0,
    "ctrl_rl_core": 0,
    "ctrl_rl_navigation": 0,
    "ctrl_rl_safety": 0,
    "ctrl_rl_learning": 0,
    "ctrl_rl_trials": 0,
    "koopman_lqr_controller": 0,
    "oc_baseline_node": 0,
    "option_coordinator": 0,
    "sim_bridge": 0,
    "ttr_reward_node": 0,
    "test/attack": 0,
    "test/benchmarks": 0,
}
TITLE = re.compile(r"([A-Z]\w+):")
BARE = re.compile(r"(of|what|how|see)\b", re.IGNORECASE)
FEWEST_WORDS = 3


def sections(docstring: str) -> Iterator[tuple[str, list[str]]]:
    """Yield title and lines of each section; the lines are those below the title that are indented."""
    title, lines = "", []
    for line in docstring.expandtabs().splitlines():
        heading = TITLE.fullmatch(line)
        if heading or (line and not line.startswith(" ")):
            yield title, lines
            title, lines = heading[1] if heading else "", []
        elif title and line.strip():
            lines.append(line)
    yield title, lines


def entries(docstring: str) -> Iterator[tuple[str, str]]:
    """Yield name and text of each entry of Args and Attributes, and the text of Returns under its title."""
    for title, lines in sections(docstring):
        if title == "Returns":
            yield title, " ".join(line.strip() for line in lines)
        elif title in ("Args", "Attributes"):
            margin = min((len(line) - len(line.lstrip()) for line in lines), default=0)
            for entry in re.split(r"\n(?! )", "\n".join(line[margin:] for line in lines)):
                name, _, text = entry.partition(": ")
                yield name, " ".join(text.split())


def is_bare(text: str) -> bool:
    """Tell whether an entry does not say what the thing is."""
    return bool(BARE.match(text)) or len(text.split()) < FEWEST_WORDS


def bare_entries(package: str) -> list[str]:
    """Return file, line, name and text of the entries of a package that do not say what the thing is."""
    found = []
    for file in sorted((ROOT / package).rglob("*.py")):
        if "test" in file.relative_to(ROOT / package).parts[:-1] and not package.startswith("test"):
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                docstring = ast.get_docstring(node)
                where = f"{file.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}"
                found += [f"{where} {name}: {text}" for name, text in entries(docstring or "") if is_bare(text)]
    return found


@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_entries_say_what_the_thing_is(package: str) -> None:
    found = bare_entries(package)
    assert len(found) <= ALLOWED[package], "\n".join(found)


@pytest.mark.parametrize(
    ("docstring", "bare"),
    [
        ("Do it.\n\nArgs:\n    age: of a scan [s].\n    rate: Scans per second [Hz].", ["age"]),
        (
            "Do it.\n\nAttributes:\n    x, y: what was seen there,\n        at most.\n    size: number.",
            ["x, y", "size"],
        ),
        ("Do it.\n\nReturns:\n    How far it is.\n\nRaises:\n    ValueError: of no kind.", ["Returns"]),
        ("Do it: of this kind.\n\nArgs:\n    *rest: Further words of the\n        of: line.", []),
    ],
)
def test_bare_entries_are_found(docstring: str, bare: list[str]) -> None:
    assert [name for name, text in entries(docstring) if is_bare(text)] == bare


if __name__ == "__main__":
    for name in sys.argv[1:] or sorted(ALLOWED):
        print(*(lines := bare_entries(name)), f"{name}: {len(lines)}", sep="\n")  # noqa: T201
