"""A deterministic policy given by a single network, for comparison with the linear models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.io import Anything, FileError, Schema, raise_as, short_repr
from ctrl_rl_learning.torch import load_arrays, save_arrays

from koopman_lqr_controller.arrays import Array
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.encoder import Encoder
from koopman_lqr_controller.policies.policy_header import EncoderHeader


class _Header(Schema):
    network: EncoderHeader
    manifest: Anything


@dataclass(frozen=True)
class NetworkPolicy:
    """A policy with the action tanh(u), u = network(x); roll-outs use u as the latent state z.

    Attributes:
        encoder: Network from x to u.
        manifest: Provenance, method and metrics of the policy: plain JSON values.
    """

    encoder: Encoder
    manifest: Mapping[str, Any] = field(default_factory=dict)

    def project(self, z: Array) -> Array:
        """Return u unchanged."""
        return z

    def control(self, z: Array) -> Array:
        """Return u unchanged."""
        return z

    def saturate(self, u: Array) -> Array:
        """Return the action tanh(u), in [-1, 1]."""
        return np.tanh(u)

    def save(self, path: Path) -> None:
        """Write the policy atomically, replacing any existing file."""
        description, tensors = self.encoder.describe()
        save_arrays(path, tensors, {"network": description, "manifest": dict(self.manifest)})

    @classmethod
    def load(cls, path: Path) -> NetworkPolicy:
        """Load a policy written by `save`.

        Raises:
            KoopmanError: The file is missing or is not such a policy; the message names it.
        """
        with raise_as(KoopmanError, path):
            tensors, header = load_arrays(path)
            told = _Header.model_validate(header)
            try:
                return cls(Encoder.build(told.network.model_dump(), tensors), told.manifest)
            except KeyError as error:
                raise FileError(f"lacks the tensor {short_repr(error.args[0])}") from None
