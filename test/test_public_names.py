"""Each package exports its public names lazily: all of them resolve, and to import the package alone loads nothing."""

import ast
import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
STUBS = sorted(ROOT.glob("*/*/__init__.pyi"))


def exported(stub: Path) -> list[tuple[str, str]]:
    """Return the module and the name of each export."""
    package = stub.parent.name
    lines = ast.parse(stub.read_text(encoding="utf-8")).body
    return [
        (f"{package}.{line.module}", name.asname or name.name)
        for line in lines
        if isinstance(line, ast.ImportFrom)
        for name in line.names
    ]


@pytest.mark.parametrize("stub", STUBS, ids=lambda stub: stub.parent.name)
def test_every_exported_name_resolves(stub: Path) -> None:
    package = import_module(stub.parent.name)
    names = exported(stub)
    assert sorted(package.__all__) == sorted(name for _, name in names)
    for module, name in names:
        assert getattr(package, name) is getattr(import_module(module), name)


@pytest.mark.parametrize("stub", STUBS, ids=lambda stub: stub.parent.name)
def test_the_package_alone_loads_none_of_its_modules(stub: Path) -> None:
    package = stub.parent.name
    code = f"import sys, {package}; print(*(name for name in sys.modules if name.startswith('{package}.')))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=os.environ, check=True)
    assert answer.stdout.strip() == ""


def test_dir_of_each_package_and_room_lists_what_the_page_of_names_lists(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "scripts" / "reference"))
    tables = re.split(r"^##+ ([\w.]+)$", import_module("names").names_page(), flags=re.MULTILINE)[1:]
    faces = dict(zip(tables[::2], tables[1::2], strict=True))
    assert set(faces) >= {stub.parent.name for stub in STUBS}
    for face, table in faces.items():
        assert re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE) == sorted(dir(import_module(face))), face


def test_there_are_public_names() -> None:
    assert {stub.parent.name for stub in STUBS} >= {
        "ctrl_rl_core",
        "ctrl_rl_bags",
        "ctrl_rl_navigation",
        "sim_bridge",
        "ttr_reward_node",
        "oc_baseline_node",
    }
