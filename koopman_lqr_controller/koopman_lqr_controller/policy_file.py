"""Policy files: safetensors with a JSON manifest in the header. Nothing in them is executed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.whole_file import write_whole
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from koopman_lqr_controller.edmd import LinearModel
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.latent_file import FORMAT as LATENT_FORMAT
from koopman_lqr_controller.latent_file import build_latent, describe_latent
from koopman_lqr_controller.latent_policy import LatentPolicy
from koopman_lqr_controller.observables import CorridorObservables
from koopman_lqr_controller.policy import KoopmanPolicy
from koopman_lqr_controller.region import Region

FORMAT = "koopman-lqr-1"
_TENSORS = ("A", "B", "K", "P", "z_ref", "u_ref", "u_low", "u_high")
_REGION = ("distance", "error")
_OBSERVABLES = ("bearings_deg", "half_width_deg", "near", "closest", "far")


DEFAULT_POLICY = "curved_corridor"
"""The learnt one of those that come with the package; "curved_corridor_edmd" is the classical one."""


def shipped_policies() -> dict[str, Path]:
    """Return the policies that come with the package, by name."""
    folder = Path(str(files("koopman_lqr_controller"))) / "policies"
    return {file.stem: file for file in sorted(folder.glob("*.safetensors"))}


def find_policy(name_or_path: str) -> Path:
    """Return the file of a shipped policy, or the path itself.

    Raises:
        KoopmanError: there is no such policy.
    """
    shipped = shipped_policies()
    path = shipped.get(name_or_path, Path(name_or_path))
    try:
        there = path.is_file()
    except OSError as error:
        raise KoopmanError(f"no policy '{name_or_path}': {error.strerror}") from None
    if not there:
        raise KoopmanError(f"no policy '{name_or_path}': there are {', '.join(shipped) or 'none'}, or give a file")
    return path


def digest(path: Path) -> str:
    """Return the SHA-256 of a policy file (hex)."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def refuse_existing(path: Path, overwrite: bool) -> None:
    """Refuse to write over a file unless that is asked for.

    Raises:
        KoopmanError: it is there.
    """
    if path.exists() and not overwrite:
        raise KoopmanError(f"{path} exists: give another name, or ask to --overwrite it")


def save_policy(policy: KoopmanPolicy | LatentPolicy, path: Path, overwrite: bool = False) -> None:
    """Write a policy; the file is there whole or not at all.

    Raises:
        KoopmanError: the file exists and `overwrite` is false, or it cannot be written.
    """
    refuse_existing(path, overwrite)
    header, tensors = describe_latent(policy) if isinstance(policy, LatentPolicy) else _describe_edmd(policy)
    if policy.region is not None:
        header["region"] = {name: getattr(policy.region, name) for name in _REGION}
        tensors |= {"region.mean": policy.region.mean, "region.covariance": policy.region.covariance}
    content = save(
        {name: np.ascontiguousarray(array) for name, array in tensors.items()}, {"policy": json.dumps(header)}
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
    except OSError as error:
        raise KoopmanError(f"cannot write {path}: {error.strerror}") from None


def load_policy(path: Path) -> KoopmanPolicy | LatentPolicy:
    """Read a policy of either kind and check it.

    Raises:
        KoopmanError: no such file, or it is not a whole and consistent policy.
    """
    try:
        with safe_open(path, framework="numpy") as file:
            header = json.loads((file.metadata() or {}).get("policy", "{}"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    # Tensors of a kind that NumPy does not know end in TypeError or AttributeError.
    except (OSError, SafetensorError, ValueError, TypeError, AttributeError) as error:
        raise KoopmanError(f"{path}: not a readable policy file ({error})") from None
    if not isinstance(header, dict):
        raise KoopmanError(f"{path}: not a readable policy file (its header is no table)")
    builders: dict[str, Callable[..., KoopmanPolicy | LatentPolicy]] = {
        FORMAT: _build_edmd,
        LATENT_FORMAT: build_latent,
    }
    build = builders.get(str(header.get("format", "")))
    if build is None:
        known = f"'{FORMAT}' or '{LATENT_FORMAT}'"
        raise KoopmanError(f"{path}: format is '{header.get('format')}', must be {known}: train it again")
    try:
        return replace(build(header, tensors), region=_region(header, tensors))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise KoopmanError(f"{path}: wrong manifest ({error}): train it again") from None
    except KoopmanError as error:
        raise KoopmanError(f"{path}: {error}") from None


def _region(header: Mapping[str, Any], tensors: Mapping[str, NDArray[Any]]) -> Region | None:
    """Return what training saw; files from before it was written down have none."""
    if "region" not in header:
        return None
    mean, covariance = (tensors[f"region.{name}"].astype(np.float64) for name in ("mean", "covariance"))
    return Region(mean, covariance, *(float(header["region"][name]) for name in _REGION))


def _describe_edmd(policy: KoopmanPolicy) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    tensors = {
        "A": policy.model.A,
        "B": policy.model.B,
        **{name: getattr(policy, name) for name in _TENSORS if name not in "AB"},
    }
    header = {
        "format": FORMAT,
        "observables": {name: getattr(policy.observables, name) for name in _OBSERVABLES},
        "observation": list(policy.observables.names),
        "action": ["speed [m/s]", "turn rate [rad/s]"],
        "manifest": dict(policy.manifest),
    }
    return header, tensors


def _build_edmd(header: Mapping[str, Any], tensors: Mapping[str, NDArray[Any]]) -> KoopmanPolicy:
    missing = [name for name in _TENSORS if name not in tensors]
    if missing:
        raise KoopmanError(f"lacks {', '.join(missing)}: train it again")
    given = header["observables"] | {"bearings_deg": tuple(header["observables"]["bearings_deg"])}
    arrays: dict[str, Any] = {name: tensors[name].astype(np.float64) for name in _TENSORS}
    return KoopmanPolicy(
        observables=CorridorObservables(**given),
        model=LinearModel(arrays.pop("A"), arrays.pop("B")),
        manifest=header["manifest"],
        **arrays,
    )
