"""No constructor calls what a class that derives from its own overrides: the object is not whole by then.

It is looked for in everything that drives a robot, `ctrl_rl_core.driving` and all that derives from it.
"""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = [
    path
    for path in ROOT.glob("*/*/**/*.py")
    if (path.parents[len(path.relative_to(ROOT).parts) - 2] / "package.xml").exists() and "test" not in path.parts
]
DRIVING = ROOT / "ctrl_rl_core" / "ctrl_rl_core" / "driving"


def read_classes() -> dict[str, tuple[Path, ast.ClassDef]]:
    """Return all classes that drive a robot, by name."""
    found = {
        node.name: (path, node)
        for path in SOURCES
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ClassDef)
    }
    known = {name for name, (path, _) in found.items() if path.parent == DRIVING}
    while more := {name for name, (_, node) in found.items() if name not in known and bases_of(node) & known}:
        known |= more
    return {name: found[name] for name in known}


def bases_of(node: ast.ClassDef) -> set[str]:
    return {base.id for base in node.bases if isinstance(base, ast.Name)}


def methods_of(node: ast.ClassDef) -> dict[str, ast.FunctionDef]:
    return {item.name: item for item in node.body if isinstance(item, ast.FunctionDef)}


def called_by(node: ast.ClassDef, method: str, seen: frozenset[str] = frozenset()) -> set[str]:
    """Return the methods of its own that a method calls at once, and what these call."""
    own = methods_of(node)
    if method not in own or method in seen:
        return set()
    direct = {
        call.func.attr
        for call in ast.walk(own[method])
        if isinstance(call, ast.Call)
        and isinstance(call.func, ast.Attribute)
        and isinstance(call.func.value, ast.Name)
        and call.func.value.id == "self"
    }
    return direct.union(*(called_by(node, name, seen | {method}) for name in direct))


def test_no_constructor_calls_what_another_class_overrides() -> None:
    classes = read_classes()
    assert {"Commander", "LidarRobot", "DriverNode", "NavigatorNode", "Controller", "WatchdogNode"} <= classes.keys()
    wrong = []
    for name, (_, node) in classes.items():
        below = {name}
        while more := {other for other, (_, each) in classes.items() if other not in below and bases_of(each) & below}:
            below |= more
        overridden = {method for other in below - {name} for method in methods_of(classes[other][1])} - {"__init__"}
        wrong += [f"{name}.__init__ calls {method}" for method in called_by(node, "__init__") & overridden]
    assert wrong == []
