"""YAML from untrusted files: bounded size and depth, no aliases, no merge keys, no duplicate keys."""

from __future__ import annotations

import os
from collections.abc import Hashable
from typing import Any

import yaml

from ctrl_rl_core.io.file_checks import FileError, as_text, read_bytes, short_repr

LARGEST = 500_000
"""Maximum size of a hand-written file [bytes]."""
DEEPEST = 40
"""Maximum nesting depth of lists and mappings."""
_LONGEST_SCALAR = 20_000


def read_yaml(path: str | os.PathLike[str]) -> Any:
    """Read a hand-written YAML file.

    Raises:
        FileError: As for `parse_yaml`, or the file is missing or too large.
        OSError: The file cannot be read.
    """
    return parse_yaml(read_bytes(path, LARGEST))


def parse_yaml(content: bytes) -> Any:
    """Parse YAML content.

    Raises:
        FileError: The content is not YAML, is nested too deeply, repeats a key, or uses aliases.
    """
    try:
        return yaml.load(as_text(content), _Loader)
    except FileError:
        raise
    except (yaml.YAMLError, ValueError, TypeError, OverflowError, RecursionError, AttributeError) as error:
        raise FileError(f"is not valid YAML: {' '.join(str(error).split())}") from None


class _Loader(yaml.SafeLoader):
    """Safe loader that rejects duplicate keys and aliases, which plain YAML accepts and expands without bound."""

    _depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        line = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent):
            raise FileError(f"has an alias in line {line}: write out what it stands for")
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > _LONGEST_SCALAR:
            raise FileError(f"has a text of {len(event.value):,} characters in line {line}")
        if self._depth >= DEEPEST:
            raise FileError(f"is nested more than {DEEPEST} levels deep in line {line}")
        self._depth += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            line = key_node.start_mark.line + 1
            if key_node.tag == "tag:yaml.org,2002:merge":
                raise FileError(f"has a merge (<<) in line {line}: write out what it stands for")
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, Hashable):
                raise FileError(f"has a key that is a list or a mapping in line {line}")
            if key in seen:
                raise FileError(
                    f"is not valid YAML: key {short_repr(key)} stands twice, the second time in line {line}"
                )
            seen.add(key)
        return super().construct_mapping(node, deep=deep)
