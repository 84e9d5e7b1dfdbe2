"""Decodes messages with the types defined in a bag.

Definitions are compiled to Python code, and a few bytes may unfold to millions of objects; both are bounded here.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ctrl_rl_bags.format.checks import DamagedError, printable, reason

MOST_OBJECTS = 2_000_000
"""Maximum number of objects in one decoded message."""
_TYPE_NAME = re.compile(r"[a-z][a-z0-9_]*/(msg|srv|action)/[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_LONGEST_NAME = 255
_LONGEST_DEFINITION = 256_000
_LONGEST_ARRAY = 10_000
"""Maximum length of an array of strings or messages, each element of which becomes a line of code."""
_MOST_FIXED_OBJECTS = 100_000
_DEEPEST = 32
_SIZES = {"8": 1, "16": 2, "32": 4, "64": 8}
_SEPARATOR = "=" * 80 + "\n"


class Definition(NamedTuple):
    """A type: name, definition (empty for ROS 2 Jazzy's), encoding, and type hash (empty if unknown)."""

    type: str
    text: str
    encoding: str
    type_hash: str


class BagTypes:
    """Decodes the messages of a set of types.

    Attributes:
        store: Type store for rosbags.
    """

    def __init__(self, definitions: Iterable[Definition]) -> None:
        """Register the definitions of the types.

        Raises:
            DamagedError: A definition is invalid, too large, or does not match its hash.
        """
        definitions = list(definitions)
        jazzy = get_typestore(Stores.ROS2_JAZZY).fielddefs
        known: dict[str, Any] = {} if all(definition.text for definition in definitions) else dict(jazzy)
        for definition in definitions:
            known |= _parsed(definition)
        self._costs: dict[str, _Cost] = {}
        for definition in definitions:
            if definition.type not in known:
                raise DamagedError(f"type {printable(definition.type)} is not defined in it")
            _cost(definition.type, known, self._costs, 0)
        self.store: Typestore = get_typestore(Stores.EMPTY)
        try:
            self.store.register(known)
            for definition in definitions:
                found = self.store.hash_rihs01(definition.type)
                if definition.type_hash.startswith("RIHS01_") and definition.text and found != definition.type_hash:
                    raise DamagedError(f"the definition of {definition.type} is not the one of its type hash")
        except DamagedError:
            raise
        except Exception as error:  # the code generator may raise almost anything for malformed definitions
            raise DamagedError(f"a message definition cannot be used: {reason(error)}") from None

    def decode(self, data: bytes, kind: str) -> Any:
        """Decode a message; arrays of numbers become NumPy arrays.

        Raises:
            DamagedError: The bytes are not such a message, or need too much memory.
        """
        cost = self._costs[kind]
        if cost.objects + len(data) * cost.objects_per_byte > MOST_OBJECTS:
            raise DamagedError(f"a {kind} of {len(data):,} bytes may expand to more than {MOST_OBJECTS:,} objects")
        try:
            return self.store.deserialize_cdr(data, kind)
        except Exception as error:
            raise DamagedError(f"a {kind} cannot be decoded: {reason(error)}") from None


class _Cost(NamedTuple):
    """Bounds of a decoded message: minimum numbers of objects and bytes, and maximum objects per byte of sequences."""

    objects: int
    least_bytes: int
    objects_per_byte: float


def _parsed(definition: Definition) -> dict[str, Any]:
    kind, text = definition.type, definition.text
    if len(kind) > _LONGEST_NAME or not _TYPE_NAME.fullmatch(kind):
        raise DamagedError(f"{printable(kind)!r} is not a message type name")
    if not text:
        return {}
    if len(text) > _LONGEST_DEFINITION:
        raise DamagedError(f"the definition of {kind} has {len(text):,} characters, at most {_LONGEST_DEFINITION:,}")
    try:
        if definition.encoding == "ros2msg":
            return dict(get_types_from_msg(text, kind))
        out: dict[str, Any] = {}
        for part in text.split(_SEPARATOR)[1:] if text.startswith(f"{_SEPARATOR}IDL: ") else [f"\n{text}"]:
            out |= get_types_from_idl(part.partition("\n")[2])
        return out
    except Exception as error:  # the parser may raise almost anything for malformed definitions
        raise DamagedError(f"the definition of {kind} cannot be read: {reason(error)}") from None


def _cost(kind: str, known: dict[str, Any], costs: dict[str, _Cost], depth: int) -> _Cost:
    if kind in costs:
        return costs[kind]
    if kind not in known:
        raise DamagedError(f"type {printable(kind)} is not defined in it")
    if depth > _DEEPEST:
        raise DamagedError(f"its types are nested more than {_DEEPEST} levels deep")
    objects, least, worst = 1, 0, 0.0
    for _, field in known[kind][1]:
        cost = _field_cost(field, known, costs, depth)
        objects, least, worst = objects + cost.objects, least + cost.least_bytes, max(worst, cost.objects_per_byte)
    if objects > _MOST_FIXED_OBJECTS:
        raise DamagedError(f"a {printable(kind)} is made of more than {_MOST_FIXED_OBJECTS:,} objects")
    costs[kind] = _Cost(objects, max(least, 1), worst)
    return costs[kind]


def _field_cost(field: Any, known: dict[str, Any], costs: dict[str, _Cost], depth: int) -> _Cost:
    node, content = field
    if node == Nodetype.BASE:
        name = content[0]
        return _Cost(1, 5 if name == "string" else _SIZES.get(name.lstrip("uintfloa"), 1), 0.0)
    if node == Nodetype.NAME:
        return _cost(content, known, costs, depth + 1)
    inner, count = content
    numbers = inner[0] == Nodetype.BASE and inner[1][0] != "string"
    element = _field_cost(inner, known, costs, depth)
    if node == Nodetype.SEQUENCE:
        worst = 0.0 if numbers else (1 + element.objects) / element.least_bytes
        return _Cost(1, 4, max(worst, element.objects_per_byte))
    if count < 1 or (count > _LONGEST_ARRAY and not numbers):
        raise DamagedError(f"it defines an array of {count:,} elements")
    return _Cost(1 if numbers else 1 + count * element.objects, count * element.least_bytes, element.objects_per_byte)
