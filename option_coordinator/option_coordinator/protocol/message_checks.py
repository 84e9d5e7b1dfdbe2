"""The ranges of the message files, as annotations of the types of `protocol_types`. No ROS.

`checks_of` returns the checks of a type by field, which are applied once to each message, where it is converted. What
depends on a team (sizes, names, options, epochs, order) is checked by the coordinator and the clients.
"""

from __future__ import annotations

import math
from collections.abc import Sized
from enum import IntEnum
from typing import Annotated, NamedTuple, get_type_hints

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


class Between(NamedTuple):
    """A number in a closed interval; NaN lies in none.

    Attributes:
        least: Lower end of the interval.
        largest: Upper end of the interval.
        or_not_finite: Whether a number that is not finite passes: the coordinator refuses that with a reason.
    """

    least: float
    largest: float
    or_not_finite: bool = False

    def __call__(self, value: float, field: str, /) -> None:
        """Raise MessageError, which names the field, if the number is refused."""
        if not self.least <= value <= self.largest and not (self.or_not_finite and not math.isfinite(value)):
            raise MessageError(f"{field} out of range")


class AtMost(NamedTuple):
    """A text or an array up to a length; errors call it by `label`, or by its field's name."""

    length: int
    label: str = ""

    def __call__(self, value: Sized, field: str, /) -> None:
        """Raise MessageError if it is longer."""
        if len(value) > self.length:
            raise MessageError(f"{self.label or field} too long")


def constants(kind: type[IntEnum]) -> Between:
    """Return the check that a number is one of an enumeration's constants, which have no gaps."""
    return Between(min(kind), max(kind))


Name = Annotated[str, AtMost(LONGEST_NAME)]
Life = Annotated[int, Between(1, LARGEST_LIFE)]
Count = Annotated[int, Between(0, LARGEST_COUNT)]
CountFrom1 = Annotated[int, Between(1, LARGEST_COUNT)]
Duration = Annotated[float, Between(0.0, LONGEST)]
OptionReward = Annotated[float, Between(-LARGEST_REWARD, LARGEST_REWARD, or_not_finite=True)]


def checks_of(kind: type) -> dict[str, Between | AtMost]:
    """Return the checks of a type's fields, by the name of the field."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: hint.__metadata__[0] for name, hint in hints.items() if hasattr(hint, "__metadata__")}
