"""The ranges of the message files, as annotations of the types of `protocol_types`. No ROS.

`checks_of` returns the checks of a type by field, which are applied once to each message, where it is converted. What
depends on a team (sizes, names, options, epochs, order) is checked by the coordinator and the clients.
"""

from __future__ import annotations

import math
from collections.abc import Sized
from enum import IntEnum
from typing import Annotated, Any, NamedTuple, Protocol, get_type_hints

from option_coordinator.errors import OptionError

LARGEST_COUNT = (1 << 62) - 1
"""Largest epoch, request or grant number. Counting from 0 never reaches it."""
LARGEST_LIFE = (1 << 63) - 1
LARGEST_REWARD = 1e9
LONGEST = 1e7
"""Longest time that an option may take [s]."""
LONGEST_NAME = 255
MOST_NUMBERS = 65536
MOST_OPTIONS = 10000
LARGEST_REQUEST = 4 * MOST_NUMBERS + MOST_OPTIONS + 2 * LONGEST_NAME + 1024
"""Largest serialised OptionRequest [bytes]."""


class MessageError(OptionError):
    """A message holds a value outside the ranges of its message file.

    Attributes:
        kind: Short reason without any of the message's content, used as the key of a counter.
    """

    def __init__(self, kind: str) -> None:
        super().__init__(kind)
        self.kind = kind


class Check(Protocol):
    """Refuses a value that no peer may send."""

    def __call__(self, value: Any, field: str, /) -> None:
        """Raise MessageError, which names the field, if the value is refused."""


class Between(NamedTuple):
    """A number in a closed interval; NaN lies in none."""

    least: float
    largest: float

    def __call__(self, value: float, field: str, /) -> None:
        """Raise MessageError if the number lies outside."""
        if not self.least <= value <= self.largest:
            raise MessageError(f"{field} out of range")


class FiniteBetween(Between):
    """A number in a closed interval, or one that is not finite: the coordinator refuses that with a reason."""

    def __call__(self, value: float, field: str, /) -> None:
        """Raise MessageError if the number is finite and lies outside."""
        if math.isfinite(value):
            super().__call__(value, field)


class AtMost(NamedTuple):
    """A text or an array up to a length; errors call it by `label`, or by its field's name."""

    length: int
    label: str = ""

    def __call__(self, value: Sized, field: str, /) -> None:
        """Raise MessageError if it is longer."""
        if len(value) > self.length:
            raise MessageError(f"{self.label or field} too long")


class OneOf(NamedTuple):
    """One of the constants of an enumeration."""

    numbers: frozenset[int]

    def __call__(self, value: int, field: str, /) -> None:
        """Raise MessageError if it is none of them."""
        if value not in self.numbers:
            raise MessageError(f"{field} out of range")


def constants(kind: type[IntEnum]) -> OneOf:
    """Return the check that a number is one of an enumeration's constants."""
    return OneOf(frozenset(int(member) for member in kind))


Name = Annotated[str, AtMost(LONGEST_NAME)]
Life = Annotated[int, Between(1, LARGEST_LIFE)]
Count = Annotated[int, Between(0, LARGEST_COUNT)]
CountFrom1 = Annotated[int, Between(1, LARGEST_COUNT)]
Duration = Annotated[float, Between(0.0, LONGEST)]
OptionReward = Annotated[float, FiniteBetween(-LARGEST_REWARD, LARGEST_REWARD)]
_KINDS = (Between, AtMost, OneOf)


def checks_of(kind: type) -> dict[str, Check]:
    """Return the checks of a type's fields, by the name of the field."""
    hints = get_type_hints(kind, include_extras=True)
    found = {
        name: [part for part in getattr(hint, "__metadata__", ()) if isinstance(part, _KINDS)]
        for name, hint in hints.items()
    }
    return {name: checks[0] for name, checks in found.items() if checks}
