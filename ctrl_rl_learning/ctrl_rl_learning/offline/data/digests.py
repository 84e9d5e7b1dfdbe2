"""Digests of recorded episodes, by which a policy's manifest says what it was fitted to."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_learning.offline.data.transitions import Transitions

_SHOWN = 16
"""Hexadecimal digits of a digest: 64 bits tell the episodes of any set of bags apart."""


def episode_digests(transitions: Transitions) -> list[str]:
    """Return a digest of each episode (episodes,), by the states and commands in it.

    Relabelling, copying, cutting and joining bags leaves the digests of whole episodes as they are.
    """
    starts = np.append(np.flatnonzero(transitions.first), len(transitions))
    out = []
    for low, high in pairwise(starts):
        both = np.concatenate((transitions.states[low:high], transitions.actions[low:high]), axis=1, dtype=np.float64)
        driven = np.round(both, 5) + 0.0
        out.append(hashlib.sha256(np.ascontiguousarray(driven, dtype="<f8").tobytes()).hexdigest()[:_SHOWN])
    return out


def fitted_to(manifest: Mapping[str, Any], transitions: Transitions) -> NDArray[np.bool_] | None:
    """Return whether a policy was fitted to each episode (episodes,); None where its manifest does not say."""
    told = manifest.get("learnt_from")
    known = told.get("digests") if isinstance(told, Mapping) else None
    if not isinstance(known, list):
        return None
    digests = set(map(str, known))
    return np.array([each in digests for each in episode_digests(transitions)], dtype=np.bool_)
