"""Policy files: safetensors with a JSON manifest in the header, without executable content."""

from __future__ import annotations

import hashlib
import math
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.io import (
    FileError,
    Tensors,
    encode_tensors,
    raise_as,
    read_bytes,
    read_tensors,
    short_path,
    short_repr,
)
from numpy.typing import NDArray

from ctrl_rl_core import atomic_write
from koopman_lqr_controller.control.latent_controller import LatentController
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.models.edmd import LinearModel
from koopman_lqr_controller.models.encoder import Encoder
from koopman_lqr_controller.policies.edmd_policy import EdmdPolicy
from koopman_lqr_controller.policies.latent_policy import LatentPolicy, RobotInterface
from koopman_lqr_controller.policies.policy_header import EdmdHeader, LatentHeader

KoopmanPolicy = EdmdPolicy | LatentPolicy
"""A linear quadratic regulator on lifted observations, of any origin."""
FORMAT, LATENT_FORMAT = "koopman-lqr-1", "koopman-latent-2"
_HEADER_KEY = "policy"
_LARGEST_LATENT = 500
"""Maximum latent dimension; the LQR of a larger one takes minutes while a robot waits."""
_TENSORS = ("K", "P", "z_ref", "u_ref", "u_low", "u_high")
_LATENT_TENSORS, _REFERENCE = ("Q", "R", "z_ref"), ("a_ref", "drift")
_COMMANDS = ["speed [m/s]", "turn rate [rad/s]"]
_REGION = ("distance", "error")
_OBSERVABLES = ("bearings_deg", "half_width_deg", "near", "closest", "far")


DEFAULT_POLICY = "curved_corridor"
"""The shipped learnt policy; "curved_corridor_edmd" is the classical one."""


def shipped_policies() -> dict[str, Path]:
    """Return the shipped policies by name."""
    folder = Path(str(files("koopman_lqr_controller"))) / "policies" / "pretrained"
    return {file.stem: file for file in sorted(folder.glob("*.safetensors"))}


def find_policy(name_or_path: str) -> Path:
    """Return the file of a shipped policy, or the path unchanged.

    Raises:
        KoopmanError: The policy does not exist.
    """
    shipped = shipped_policies()
    path = shipped.get(name_or_path, Path(name_or_path).expanduser())
    try:
        there = path.exists()
    except (OSError, ValueError) as error:
        raise KoopmanError(f"no policy '{short_path(name_or_path)}': {error}") from None
    if not there:
        raise KoopmanError(
            f"no policy '{short_path(name_or_path)}': there are {', '.join(shipped) or 'none'}, or give a file"
        )
    return path


def digest(path: Path) -> str:
    """Return the SHA-256 of a policy file (hex)."""
    with raise_as(KoopmanError, path):
        return hashlib.sha256(read_bytes(path, math.inf)).hexdigest()


def refuse_existing(path: Path, overwrite: bool) -> None:
    """Raise if a file exists, unless overwriting is requested.

    Raises:
        KoopmanError: The file exists.
    """
    if path.exists() and not overwrite:
        raise KoopmanError(f"{short_path(path)} exists: give another name, or --overwrite to replace it")


def save_policy(policy: KoopmanPolicy, path: Path, overwrite: bool = False) -> None:
    """Write a policy atomically.

    Raises:
        KoopmanError: The file exists and `overwrite` is false, or cannot be written.
    """
    refuse_existing(path, overwrite)
    header, tensors = _describe_latent(policy) if isinstance(policy, LatentPolicy) else _describe_edmd(policy)
    if policy.distribution is not None:
        header["region"] = {name: getattr(policy.distribution, name) for name in _REGION}
        tensors |= {"region.mean": policy.distribution.mean, "region.covariance": policy.distribution.covariance}
    content = encode_tensors(tensors, _HEADER_KEY, header)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(path, content)
    except OSError as error:
        raise KoopmanError(f"cannot write {path}: {error.strerror}") from None


def load_policy(path: Path) -> KoopmanPolicy:
    """Load and validate a policy of either kind.

    Raises:
        KoopmanError: The file does not exist, or is not a complete and consistent policy.
    """
    with raise_as(KoopmanError, path):
        header, tensors, _ = read_tensors(path, _HEADER_KEY)
        large = [name for name in ("A", "P") if max(tensors.get(name, np.empty(0)).shape, default=0) > _LARGEST_LATENT]
        if large:
            raise FileError(f"{large[0]} has more than {_LARGEST_LATENT} rows or columns")
        found = header.get("format")
        try:
            if found == FORMAT:
                return _build_edmd(EdmdHeader.model_validate(header), tensors)
            if found == LATENT_FORMAT:
                return _build_latent(LatentHeader.model_validate(header), tensors)
        except KeyError as error:
            raise FileError(f"lacks the tensor {short_repr(error.args[0])}: train it again") from None
        raise FileError(f"format is {short_repr(found)}, must be '{FORMAT}' or '{LATENT_FORMAT}': train it again")


def _describe_edmd(policy: EdmdPolicy) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    tensors = {"A": policy.model.A, "B": policy.model.B, **{name: getattr(policy, name) for name in _TENSORS}}
    header = {
        "format": FORMAT,
        "observables": {name: getattr(policy.observables, name) for name in _OBSERVABLES},
        "observation": list(policy.observables.names),
        "action": _COMMANDS,
        "manifest": dict(policy.manifest),
    }
    return header, tensors


def _build_edmd(told: EdmdHeader, tensors: Tensors) -> EdmdPolicy:
    arrays: dict[str, Any] = {name: tensors[name].astype(np.float64) for name in ("A", "B", *_TENSORS)}
    return EdmdPolicy(
        observables=told.observables.observables,
        model=LinearModel(arrays.pop("A"), arrays.pop("B")),
        manifest=told.manifest.model_dump(exclude_unset=True),
        distribution=told.training_distribution(tensors),
        **arrays,
    )


def _describe_latent(policy: LatentPolicy) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    controller, robot_interface = policy.controller, policy.robot_interface
    encoder, tensors = controller.encoder.describe()
    names = _LATENT_TENSORS if controller.horizon is not None else _LATENT_TENSORS + _REFERENCE
    tensors |= {"A": controller.model.A, "B": controller.model.B, **{name: getattr(controller, name) for name in names}}
    if controller.projection is not None:
        tensors["projection"] = controller.projection
    header: dict[str, Any] = {
        "format": LATENT_FORMAT,
        "encoder": encoder,
        "dt": policy.dt,
        "horizon": controller.horizon,
        "manifest": dict(policy.manifest),
    }
    if robot_interface is not None:
        tensors |= {"u_low": robot_interface.u_low, "u_high": robot_interface.u_high}
        header |= {"observation": asdict(robot_interface.observation), "action": _COMMANDS}
    return header, tensors


def _build_latent(told: LatentHeader, tensors: Tensors) -> LatentPolicy:
    """Create the policy and compute its gain."""
    names = _LATENT_TENSORS if told.horizon is not None else _LATENT_TENSORS + _REFERENCE
    given = {name: np.ascontiguousarray(tensors[name], dtype=np.float64) for name in ("A", "B", *names)}
    model, projection = LinearModel(given.pop("A"), given.pop("B")), tensors.get("projection")
    encoder = Encoder.build(told.encoder.model_dump(), tensors)
    controller = LatentController(
        encoder,
        model,
        horizon=told.horizon,
        projection=None if projection is None else projection.astype(np.float64),
        **given,
    )
    robot_interface = None
    if told.observation is not None:
        low, high = (tensors[name].astype(np.float64) for name in ("u_low", "u_high"))
        robot_interface = RobotInterface(told.observation.observation, low, high)
    manifest = told.manifest.model_dump(exclude_unset=True)
    return LatentPolicy(controller, told.dt, robot_interface, manifest, told.training_distribution(tensors))
