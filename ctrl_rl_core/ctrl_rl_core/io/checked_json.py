"""JSON from untrusted files: bounded size and depth, no duplicate keys, and a digest that reveals damage."""

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
"""Maximum file size [bytes]."""
DEEPEST = 40
"""Maximum nesting depth of lists and objects."""
DIGEST = "sha256"
"""Key of the digest in the top-level object."""
_LONGEST_NUMBER = 40
_MARKS = re.compile(r'"(?:[^"\\]|\\.)*+"?|[\[\]{}]', re.DOTALL)
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
_told: set[str] = set()


def parse_json(text: str) -> Any:
    """Parse JSON text. NaN and infinity are accepted, as Python writes them; schemas reject them.

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
    """Read a JSON file, check its digest and return the content without it.

    Raises:
        FileError: As for `parse_json`, or the file is missing, too large or damaged.
        OSError: The file cannot be read.
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
    """Return an object with the digest that `read_json` checks."""
    plain = json.loads(json.dumps(dict(content)))
    return {**content, DIGEST: digest(plain)}


def digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 (hex) of an object's content, independent of layout and key order."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def warn_missing_digest(path: str | os.PathLike[str]) -> None:
    """Warn once per file that it has no digest."""
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
