"""The page of file schemas: keys of tasks, teams, policies and values, from the classes that validate them."""

from __future__ import annotations

import inspect
import re
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from docstring_parser import parse
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

_HEAD = """# File schemas

The classes that validate the suite's files, with the type of each key. Unknown keys and wrong values are refused in one
line that names file and key. [Tasks](../tasks.md) shows a whole task file and how to write quantities;
[files](../files.md) has limits and digests.
"""
_MODULES = {
    "Task files": (
        "ctrl_rl_core.tasks.schema.parts",
        "ctrl_rl_core.tasks.schema.system",
        "ctrl_rl_core.tasks.schema.robot",
        "ctrl_rl_core.tasks.schema.world",
        "ctrl_rl_core.tasks.schema.movers",
        "ctrl_rl_core.tasks.schema.randomisation",
        "ctrl_rl_core.tasks.schema.optimal_control",
        "ctrl_rl_core.tasks.task",
        "ctrl_rl_core.tasks.option_tasks",
    ),
    "Team files": ("option_coordinator.teams.team_file",),
    "Headers of Koopman policies": ("koopman_lqr_controller.policies.policy_header",),
    "Headers of option policies": ("option_coordinator.policies.policy_file",),
    "Headers of value grids": ("ctrl_rl_core.values.grid_file", "ttr_reward_node.values.decomposed_value"),
    "Interfaces of policies": ("ctrl_rl_core.policies.manifest",),
    "Headers of networks": ("oc_baseline_node.values.value_file", "ctrl_rl_core.policies.actor"),
    "Results": ("ctrl_rl_core.io.results",),
}


def schema_page() -> str:
    """Return the page, with one table per class for each kind of file."""
    parts = [_HEAD]
    for title, modules in _MODULES.items():
        parts.append(f"## {title}\n")
        for name in (module for given in modules for module in _with_parts(given)):
            kinds = [each for each in vars(import_module(name)).values() if isinstance(each, type)]
            parts += [_section(kind) for kind in kinds if issubclass(kind, BaseModel) and kind.__module__ == name]
    return "\n".join(parts)


def _with_parts(name: str) -> list[str]:
    """Return the name of a module and, if it is a package, of the modules in it."""
    folders = getattr(import_module(name), "__path__", [])
    return [name, *(f"{name}.{each.name}" for each in iter_modules(folders))]


def _section(kind: type[BaseModel]) -> str:
    doc = parse(inspect.getdoc(kind) or "")
    told = {each.arg_name: each.description for each in doc.params}
    lines = [f"### {kind.__name__.lstrip('_')}\n", (doc.description or "").strip() + "\n"]
    if not kind.model_fields:
        return "\n".join(lines)
    lines += ["| key | type | default | meaning |", "|---|---|---|---|"]
    for name, field in kind.model_fields.items():
        text = " ".join((told.get(name) or field.description or "").split())
        cells = (f"`{name}`", f"`{_type(field)}`", _default(field), text)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _type(field: Any) -> str:
    text = field.annotation.__name__ if isinstance(field.annotation, type) else str(field.annotation)
    text = re.sub(r"Annotated\[(\w+), [^\[\]]*(\[[^\[\]]*\][^\[\]]*)*\]", r"\1", text)
    text = re.sub(r"\b(?:[a-z_]\w*\.)+(?=\w)", "", text)
    return re.sub(r"\b_(?=[A-Z])", "", text)


def _default(field: Any) -> str:
    if field.is_required():
        return "required"
    value = field.default if field.default is not PydanticUndefined else "empty"
    return "" if value is None else f"{value}"
