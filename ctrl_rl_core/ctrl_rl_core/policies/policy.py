"""Policies of any kind: their common interface, and how they are found and loaded.

A package adds its own file kind with an entry point of the group `ctrl_rl.policies` that names a `PolicyKind`:

    entry_points={"ctrl_rl.policies": ["my_header_key = my_package.my_module:KIND"]}

The entry point's name is the header key of the safetensors files, or the suffix of other files, such as `onnx`.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ctrl_rl_core.driving.drive import Driver
from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.io.checked_tensors import kind_of
from ctrl_rl_core.io.file_checks import one_line, raise_as, read_bytes, short_path
from ctrl_rl_core.networks.layers import Network
from ctrl_rl_core.plugins import find_plugins, load_plugin
from ctrl_rl_core.policies.errors import PolicyError
from ctrl_rl_core.policies.manifest import PolicyManifest
from ctrl_rl_core.policies.observation import ObservationBuilder
from ctrl_rl_core.sensing.odometry import make_odometry
from ctrl_rl_core.sensing.scan import ScanGeometry, Sensors

Array = NDArray[np.float64]
GROUP = "ctrl_rl.policies"
_SOME_SCAN = ScanGeometry(360, 0.0, 2.0 * np.pi / 360, 0.1, 30.0)


@runtime_checkable
class Policy(Driver[Sensors], Protocol):
    """A learnt policy for one robot.

    Attributes:
        robot: Kind of robot, a key of `manifest.COMMAND_NAMES`.
        limits: Minimum and maximum command (2,), (2,).
        rest: Idle command (2,).
        period: Decision period [s]; None to decide at each scan.
        needs: Required inputs besides scan and odometry: "pose", "goal", both or none.
        description: Short description of the policy's kind and origin.
    """

    robot: str
    limits: tuple[Array, Array]
    rest: Array
    period: float | None
    needs: frozenset[str]
    description: str


class PolicyDriver:
    """A policy as driven by its node: clipped to its limits, and idle when it returns no command."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy

    def command(self, sensors: Sensors) -> Array:
        """Return the command (2,)."""
        try:
            return np.clip(self._policy.command(sensors), *self._policy.limits)
        except CtrlRlError:
            return self._policy.rest


class PolicyDescription(NamedTuple):
    """A policy's computation and origin, for export to other formats.

    Attributes:
        network: The computation, from the observation to outputs.
        outputs: The policy's own result in place of `network`, by head. With a manifest, a function from sensor
            readings whose "action" is the command (2,); without one, a function from an observation (n,). NaN where
            a value is left out of a comparison.
        training: Origin of the policy, as in its file's header: task, method, seed; JSON values.
        manifest: Observation and commands on a robot; None if no node can drive by the network.
        remarks: What network and manifest leave out, in sentences.
    """

    network: Network
    outputs: Callable[[Any], Mapping[str, NDArray[Any]]]
    training: Mapping[str, Any]
    manifest: PolicyManifest | None = None
    remarks: tuple[str, ...] = ()


class PolicyKind(NamedTuple):
    """A kind of policy file.

    Attributes:
        load: Loads the policy of a file, or raises CtrlRlError with a one-line message.
        shipped: Returns the files shipped with the package, by name.
        describe: Describes the policy of a file, or raises CtrlRlError; None if this kind cannot be exported.
    """

    load: Callable[[Path], Policy]
    shipped: Callable[[], Mapping[str, Path]] = dict
    describe: Callable[[Path], PolicyDescription] | None = None


class NetworkPolicy:
    """A network with the interface given by its manifest."""

    def __init__(
        self, manifest: PolicyManifest, network: Callable[[NDArray[np.float32]], NDArray[Any]], description: str
    ) -> None:
        """Create a policy.

        Args:
            manifest: Interface of the policy.
            network: Function from an observation (n,) to outputs (`manifest.action.outputs`,).
            description: Short description of the policy's kind and origin.
        """
        self.robot: str = manifest.robot
        self.period, self.description = manifest.period, description
        self.limits = np.array(manifest.action.low), np.array(manifest.action.high)
        self.rest: Array = np.array(manifest.rest)
        self.needs = frozenset[str](each for each in ("pose", "goal") if manifest.observes(each))
        if "goal" in self.needs:
            self.needs |= {"pose"}
        self._observe, self._network, self._action = ObservationBuilder(manifest), network, manifest.action

    def command(self, sensors: Sensors) -> Array:
        """Return the command (2,); not finite if the network's outputs are not.

        Raises:
            PolicyError: A component of the observation is missing.
        """
        with np.errstate(all="ignore"):  # the node rejects non-finite commands with a message
            return self._action.command(np.asarray(self._network(self._observe(sensors)), dtype=np.float64))


def find_policy(name_or_path: str) -> Path:
    """Return the file of a shipped policy by name, or the path unchanged.

    Raises:
        PolicyError: There is no such policy.
    """
    path = Path(name_or_path)
    if path.suffix:
        return path.expanduser()
    shipped = shipped_policies()
    if name_or_path not in shipped:
        there = ", ".join(shipped) or "none"
        asked = f"no policy '{short_path(name_or_path)}'" if name_or_path else "no policy is given (parameter policy)"
        raise PolicyError(f"{asked}: there are {there}, or give a file")
    return shipped[name_or_path]


def shipped_policies() -> dict[str, Path]:
    """Return the policies shipped with the installed packages, by name."""
    shipped: dict[str, Path] = {}
    for entry in find_plugins(GROUP).values():
        with suppress(PolicyError):  # a broken package must not prevent driving with another package's policy
            shipped |= sorted(_kind(entry).shipped().items())
    return shipped


def load_policy(path: Path) -> Policy:
    """Load a policy of any kind and test it on a scan.

    Raises:
        PolicyError: The file is missing or not a policy, or a package needed to read it is not installed.
    """
    with raise_as(PolicyError, path):
        policy = _kind_of_file(path).load(path)
        _try(policy)
    return policy


def describe_policy(path: Path) -> PolicyDescription:
    """Describe a policy of any kind for export.

    Raises:
        PolicyError: As for `load_policy`, or this kind or one of its layers cannot be exported.
    """
    with raise_as(PolicyError, path):
        kind = _kind_of_file(path)
        if kind.describe is None:
            raise PolicyError("is of a kind that does not describe its network: it cannot be exported")
        return kind.describe(path)


def policy_digest(path: Path) -> str:
    """Return the SHA-256 (hex) of a policy: its file, including the manifest of an ONNX model.

    Raises:
        PolicyError: A file cannot be read.
    """
    with raise_as(PolicyError, path):
        out = hashlib.sha256(read_bytes(path, math.inf))
    if path.suffix == ".onnx":
        beside = path.with_suffix(".yaml")
        with raise_as(PolicyError, beside):
            out.update(read_bytes(beside, math.inf))
    return out.hexdigest()


def _try(policy: Policy) -> None:
    """Raise if the policy does not return two finite numbers in a simple situation."""
    wall = np.ones(_SOME_SCAN.beams, np.float32)
    sensors = Sensors(wall, _SOME_SCAN, make_odometry(np.zeros(3), np.zeros(3)), np.zeros(3), np.ones(3), policy.rest)
    command = policy.command(sensors)
    if command.shape != (2,) or not np.isfinite(command).all():
        raise PolicyError(f"its command in front of a wall at 1 m is {one_line(command.tolist(), 60)}: not two numbers")


def _kind_of_file(path: Path) -> PolicyKind:
    """Return the kind of a file, from its ending or its header."""
    ending, entries = path.suffix.removeprefix(".").lower(), find_plugins(GROUP)
    keys = (ending,) if ending in entries else kind_of(path)
    entry = next((entries[key] for key in keys if key in entries), None)
    if entry is None:
        raise PolicyError(f"holds no policy that a node can drive by: there are readers for {', '.join(entries)}")
    return _kind(entry)


def _kind(entry: EntryPoint) -> PolicyKind:
    return load_plugin(entry, PolicyKind, "the reader", PolicyError)
