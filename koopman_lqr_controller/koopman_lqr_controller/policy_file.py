"""Policy files: safetensors with a JSON manifest in the header. Nothing in them is executed."""

from __future__ import annotations

import hashlib
import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from ctrl_rl_core.whole_file import write_whole
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from koopman_lqr_controller.edmd import LinearModel
from koopman_lqr_controller.errors import KoopmanError
from koopman_lqr_controller.observables import CorridorObservables
from koopman_lqr_controller.policy import KoopmanPolicy

FORMAT = "koopman-lqr-1"
_TENSORS = ("A", "B", "K", "P", "z_ref", "u_ref", "u_low", "u_high")
_OBSERVABLES = ("bearings_deg", "half_width_deg", "near", "closest", "far")


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
    if not path.is_file():
        raise KoopmanError(f"no policy '{name_or_path}': there are {', '.join(shipped) or 'none'}, or give a file")
    return path


def digest(path: Path) -> str:
    """Return the SHA-256 of a policy file (hex)."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def save_policy(policy: KoopmanPolicy, path: Path, overwrite: bool = False) -> None:
    """Write a policy; the file is there whole or not at all.

    Raises:
        KoopmanError: the file exists and `overwrite` is false, or it cannot be written.
    """
    if path.exists() and not overwrite:
        raise KoopmanError(f"{path} exists: give another name, or ask to overwrite it")
    tensors = {
        "A": policy.model.A,
        "B": policy.model.B,
        **{name: getattr(policy, name) for name in _TENSORS if name not in "AB"},
    }
    observables: dict[str, Any] = {name: getattr(policy.observables, name) for name in _OBSERVABLES}
    header = {
        "format": FORMAT,
        "observables": observables,
        "observation": list(policy.observables.names),
        "action": ["speed [m/s]", "turn rate [rad/s]"],
        "manifest": dict(policy.manifest),
    }
    content = save(
        {name: np.ascontiguousarray(array) for name, array in tensors.items()}, {"policy": json.dumps(header)}
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, content)
    except OSError as error:
        raise KoopmanError(f"cannot write {path}: {error.strerror}") from None


def load_policy(path: Path) -> KoopmanPolicy:
    """Read a policy and check it.

    Raises:
        KoopmanError: no such file, or it is not a whole and consistent policy.
    """
    try:
        with safe_open(path, framework="numpy") as file:
            header = json.loads((file.metadata() or {}).get("policy", "{}"))
            tensors = {name: file.get_tensor(name).astype(np.float64) for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError, ValueError) as error:
        raise KoopmanError(f"{path}: not a readable policy file ({error})") from None
    if header.get("format") != FORMAT:
        raise KoopmanError(f"{path}: format is '{header.get('format')}', must be '{FORMAT}': train it again")
    missing = [name for name in _TENSORS if name not in tensors]
    if missing:
        raise KoopmanError(f"{path}: lacks {', '.join(missing)}: train it again")
    try:
        given = header["observables"] | {"bearings_deg": tuple(header["observables"]["bearings_deg"])}
        observables = CorridorObservables(**given)
        arrays = {name: tensors[name] for name in _TENSORS if name not in "AB"}
        return KoopmanPolicy(
            observables=observables,
            model=LinearModel(tensors["A"], tensors["B"]),
            manifest=header["manifest"],
            **arrays,
        )
    except (KeyError, TypeError) as error:
        raise KoopmanError(f"{path}: wrong manifest ({error}): train it again") from None
    except KoopmanError as error:
        raise KoopmanError(f"{path}: {error}") from None
