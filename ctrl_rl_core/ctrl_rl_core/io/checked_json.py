"""JSON from untrusted files: bounded size and depth, no repeated keys, and a digest that reveals damage."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import re
from collections import Counter
from collections.abc import Mapping
from typing import Any

from ctrl_rl_core.io.file_checks import FileError, as_text, one_line, read_bytes, short_path, short_repr

LARGEST = 64_000_000
"""Bytes of a file."""
DEEPEST = 40
"""Levels of lists and objects within each other."""
DIGEST = "sha256"
"""Key of the digest, beside the others."""
_LONGEST_NUMBER = 40
_MARKS = re.compile(r'"(?:[^"\\]|\\.)*+"?|[\[\]{}]', re.DOTALL)
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
_told: set[str] = set()


def parse_json(text: str) -> Any:
    """Parse a JSON text. NaN and infinity, which Python writes, are accepted here; schemas reject them.

    Raises:
        FileError: The text is not JSON, is nested too deeply, or repeats a key.
    """
    _check_depth(text)
    try:
        content = json.loads(text, object_pairs_hook=_object, parse_int=_whole)
        if _SURROGATE.search(text):
            json.dumps(content, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        raise FileError("is not valid JSON: half of a character") from None
    except (ValueError, RecursionError) as error:
        raise FileError(f"is not valid JSON: {error}") from None
    return content


def read_json(path: str | os.PathLike[str], largest: float = LARGEST) -> Any:
    """Return the content of a JSON file, without its digest, which is checked.

    Raises:
        FileError: As `parse_json`, the file is none or too large, or it is damaged.
        OSError: It cannot be read.
    """
    content = parse_json(as_text(read_bytes(path, largest)))
    if not isinstance(content, dict):
        return content
    found = content.pop(DIGEST, None)
    if found is None:
        warn_missing_digest(path)
    elif found != digest(content):
        raise FileError("does not match its digest: it is damaged, or was changed by hand")
    return content


def with_digest(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return an object and its digest, as `read_json` checks it."""
    plain = json.loads(json.dumps(dict(content)))
    return {**content, DIGEST: digest(plain)}


def digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 (hex) of an object's content; layout and order of keys do not count."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def warn_missing_digest(path: str | os.PathLike[str]) -> None:
    """Warn, once for each file, that it has no digest."""
    name = short_path(path)
    if name not in _told:
        _told.add(name)
        message = "%s: has no digest of all of it, as an earlier version wrote it: damage may go unnoticed"
        logging.getLogger(__name__).warning(message, name)


def _check_depth(text: str) -> None:
    depth = 0
    for mark in _MARKS.finditer(text):
        found = mark[0]
        if found in "[{":
            depth += 1
            if depth > DEEPEST:
                raise FileError(f"is nested more than {DEEPEST} levels deep")
        elif found in "]}":
            depth -= 1


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) < len(pairs):
        counts = Counter(key for key, _ in pairs)
        twice = counts.most_common(1)[0][0]
        raise FileError(f"has the key {short_repr(twice)} twice")
    return out


def _whole(digits: str) -> int:
    if len(digits) > _LONGEST_NUMBER:
        raise FileError(f"has a number of {len(digits)} digits: {one_line(digits, 20)}")
    return int(digits)
