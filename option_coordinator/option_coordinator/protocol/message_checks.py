"""What any message may say, whoever sent it: the ranges of the message files. Pure: no ROS.

Every number and name that a coordinator or a robot reads from a message passes here once, where messages become the
types of `exchange`. What depends on a team (sizes, names, options, epochs, order) is checked by who knows the team.
"""

from __future__ import annotations

from collections.abc import Sized

from option_coordinator.errors import OptionError

LARGEST_COUNT = (1 << 62) - 1
"""Of epochs, request and grant numbers: counting does not reach it."""
LARGEST_LIFE = (1 << 63) - 1
LARGEST_REWARD = 1e9
LONGEST = 1e7
"""Longest time that an option may take [s]."""
LONGEST_NAME = 255
MOST_NUMBERS = 65536
MOST_OPTIONS = 10000
LARGEST_REQUEST = 4 * MOST_NUMBERS + MOST_OPTIONS + 2 * LONGEST_NAME + 1024
"""Of a serialised OptionRequest [bytes]."""


class MessageError(OptionError):
    """A message holds what no peer may say.

    Attributes:
        kind: A few words, to count by; nothing of the message's content.
    """

    def __init__(self, kind: str) -> None:
        super().__init__(kind)
        self.kind = kind


def name(text: str, what: str) -> str:
    """Return a name that is not too long.

    Raises:
        MessageError: it is.
    """
    if len(text) > LONGEST_NAME:
        raise MessageError(f"{what} too long")
    return text


def number(value: int, what: str, least: int = 0, largest: int = LARGEST_COUNT) -> int:
    """Return a whole number that lies in a range.

    Raises:
        MessageError: it does not.
    """
    if not least <= value <= largest:
        raise MessageError(f"{what} out of range")
    return value


def real(value: float, what: str, least: float, largest: float) -> float:
    """Return a real number that lies in a range; NaN lies in none.

    Raises:
        MessageError: it does not.
    """
    if not least <= value <= largest:
        raise MessageError(f"{what} out of range")
    return value


def sized(values: Sized, what: str, most: int) -> None:
    """See to it that an array is not too long.

    Raises:
        MessageError: it is.
    """
    if len(values) > most:
        raise MessageError(f"{what} too long")
