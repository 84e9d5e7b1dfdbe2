"""Message types by name: Python class, definition text for bags, and type stores for rosbags.

Classes and texts come from the packages on the ament index (`share/<package>/msg/*.msg`). Since names come from bags
and other machines, `check_type` must find a name in an installed interface package before anything is imported.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from ament_index_python.resources import get_resource
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ctrl_rl_core import CtrlRlError

_SEPARATOR = "=" * 80
_PRIMITIVE = re.compile(r"bool|byte|char|float(32|64)|u?int(8|16|32|64)|w?string")
_TYPE = re.compile(r"^([A-Za-z]\w*/)?(?:msg/)?([A-Za-z]\w*)")
_TYPE_NAME = re.compile(r"(?!\w*__|\w*_/)[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*", re.ASCII)
"""Naming rule of ROS: https://design.ros2.org/articles/legacy_interface_definition.html, "Naming of messages ..."."""
_LONGEST_NAME = 255
_LONGEST_SHOWN = 80


class UnknownTypeError(CtrlRlError):
    """A message type is not installed: its package is not sourced or not built."""


def is_type_name(name: str) -> bool:
    """Return whether a text is a valid ROS message type name: `package/msg/Name`."""
    return len(name) <= _LONGEST_NAME and _TYPE_NAME.fullmatch(name) is not None


def check_type(name: str) -> None:
    """Raise if a type name is invalid or not in any installed interface package, without importing anything.

    Raises:
        UnknownTypeError: The type is not installed, or the name is invalid.
    """
    if not is_type_name(name):
        shown = name if len(name) <= _LONGEST_SHOWN else f"{name[:_LONGEST_SHOWN]}..."
        raise UnknownTypeError(f"{shown!r} is not a message type name: it must be like package/msg/Name")
    package, _, short = name.partition("/msg/")
    try:
        interfaces, _ = get_resource("rosidl_interfaces", package)
    except (LookupError, OSError, ValueError):
        interfaces = ""
    if not {f"msg/{short}.msg", f"msg/{short}.idl"} & set(interfaces.split()):
        raise UnknownTypeError(f"type {name} is not installed here: source the workspace that has {package}")


def message_class(name: str) -> Any:
    """Return the class of a type such as `sensor_msgs/msg/LaserScan`.

    Raises:
        UnknownTypeError: The type is not installed.
    """
    check_type(name)
    package, _, short = name.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), short)
    except (ImportError, AttributeError):
        raise UnknownTypeError(f"type {name} cannot be imported: build and source {package} again") from None


def message_definition(name: str) -> str:
    """Return the definition of a type followed by those of all nested types, as in a `ros2msg` schema.

    Raises:
        UnknownTypeError: A definition is not installed.
    """
    texts = {name: _text(name)}
    waiting = [name]
    while waiting:
        outer = waiting.pop()
        for inner in _nested(outer, texts[outer]):
            if inner not in texts:
                texts[inner] = _text(inner)
                waiting.append(inner)
    head = texts.pop(name)
    return head + "".join(f"{_SEPARATOR}\nMSG: {inner.replace('/msg/', '/')}\n{text}" for inner, text in texts.items())


def _text(name: str) -> str:
    check_type(name)
    package, _, short = name.partition("/msg/")
    try:
        text = (Path(get_package_share_directory(package)) / "msg" / f"{short}.msg").read_text(encoding="utf-8")
    except (PackageNotFoundError, OSError, ValueError):
        raise UnknownTypeError(f"no definition of {name} is installed here: source the workspace that has it") from None
    return text.rstrip("\n") + "\n"


def _nested(name: str, text: str) -> Iterator[str]:
    own_package = name.partition("/")[0]
    for line in text.splitlines():
        found = _TYPE.match(line.partition("#")[0].strip())
        if found is None or (found[1] is None and _PRIMITIVE.fullmatch(found[2])):
            continue
        # `Header` is the only name that is valid without a package.
        package = found[1][:-1] if found[1] else "std_msgs" if found[2] == "Header" else own_package
        yield f"{package}/msg/{found[2]}"


def typestore(*names: str) -> Typestore:
    """Return a type store with Jazzy's and these types, to serialise and parse messages without their classes.

    Raises:
        UnknownTypeError: A definition is not installed.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    register(store, *names)
    return store


def register(store: Typestore, *names: str) -> None:
    """Add missing types to a store.

    Raises:
        UnknownTypeError: A definition is not installed.
    """
    for name in names:
        known = get_types_from_msg(message_definition(name), name)
        store.register({kind: fields for kind, fields in known.items() if kind not in store.fielddefs})
