"""Types by which messages are written and read without their Python classes."""

from __future__ import annotations

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ctrl_rl_bags.recording.message_types import message_definition


def typestore(*names: str) -> Typestore:
    """Return a store of Jazzy's types and of these, which writes and reads messages without their classes.

    Raises:
        UnknownTypeError: A definition is not installed here.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    register(store, *names)
    return store


def register(store: Typestore, *names: str) -> None:
    """Add types to a store; those that it knows stay as they are.

    Raises:
        UnknownTypeError: A definition is not installed here.
    """
    for name in names:
        known = get_types_from_msg(message_definition(name), name)
        store.register({kind: fields for kind, fields in known.items() if kind not in store.fielddefs})
