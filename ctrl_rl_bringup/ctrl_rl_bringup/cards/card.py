"""The card of a policy, as Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

from ctrl_rl_core.policies import OBSERVATIONS, ScanPart, policy_digest

from ctrl_rl_bringup.cards.success import ENGINES, Success, task_of
from ctrl_rl_core import PolicyDescription, PolicyManifest

COMMANDS = {
    "differential_drive": (("v", "m/s"), ("omega", "rad/s")),
    "planar_quadrotor": (("T_1", "N"), ("T_2", "N")),
}
"""Names and units of the commands, by kind of robot."""
NOT_RECORDED = "not in the file"
_MEASURE = "ros2 run ctrl_rl_bringup transfer --policies {name}={file} --task {task} --results transfer.json"


@dataclass(frozen=True)
class Card:
    """What a card says.

    Attributes:
        name: Name of the policy.
        file: Its file.
        description: Its network, interface and origin.
        shipped: Whether the policy ships with the suite, and so has its licence.
        success: Success by engine and condition; None if not measured.
        figures: Lines in place of `success`, for a policy without a robot.
        difference: Largest difference of its ONNX model from the policy, relative to its range; None if not measured.
    """

    name: str
    file: Path
    description: PolicyDescription
    shipped: bool = False
    success: Success | None = None
    figures: Sequence[str] = ()
    difference: float | None = None

    def text(self) -> str:
        """Return the card."""
        manifest = self.description.manifest
        lines = [f"# {self.name}", ""]
        if manifest is not None and manifest.about:
            lines += [manifest.about, ""]
        lines += ["| | |", "|---|---|", *(f"| {key} | {value} |" for key, value in self._facts())]
        lines += ["", "## Success", "", *self._success(), "", "## Limits", "", *self._limits()]
        if manifest is not None:
            lines += ["", "## Observation", "", *_observation(manifest)]
            lines += ["", "## Commands", "", *_commands(manifest)]
        else:
            lines += ["", "## Outputs", "", *self._outputs()]
        return "\n".join([*lines, "", "## Use", "", *self._use()]) + "\n"

    @property
    def method(self) -> str:
        """The method of training, as its file names it."""
        training = self.description.training
        told = [str(training[key]) for key in ("method", "algorithm") if training.get(key)]
        reward = training.get("reward")
        return ", ".join([*told, *([f"reward {reward}"] if reward else [])]) or NOT_RECORDED

    def _facts(self) -> Iterator[tuple[str, str]]:
        training, manifest = self.description.training, self.description.manifest
        task = task_of(self.description)
        digest = training.get("task_digest")
        yield "task", NOT_RECORDED if task is None else f"`{task}`{f', digest {digest}' if digest else ''}"
        if manifest is not None:
            yield "robot", manifest.robot.replace("_", " ")
            yield "decides", "at each scan" if manifest.period is None else f"every {manifest.period:g} s"
        yield "trained by", self.method
        yield "samples", self._samples()
        yield "seed", str(training.get("seed", NOT_RECORDED))
        if training.get("command"):
            yield "command", f"`{training['command']}`"
        yield "policy file", f"SHA-256 {policy_digest(self.file)}"
        yield "ONNX model", self._exactness()
        yield "licence", _licence() if self.shipped else "not stated: its owner's"

    def _samples(self) -> str:
        training = self.description.training
        interaction, snapshots = training.get("interaction"), training.get("snapshots")
        found = training.get("samples")
        if found is None and isinstance(interaction, dict):
            found = interaction.get("actions")
        if found is None and isinstance(snapshots, dict):
            found = snapshots.get("fitted")
        return f"{found:,}" if isinstance(found, int) else NOT_RECORDED

    def _exactness(self) -> str:
        if self.difference is None:
            return "not measured: export it with `--onnx`"
        of = "of the commands' range" if self.description.manifest is not None else "in each probability or action"
        return f"differs by at most {self.difference:.1e} {of} on {OBSERVATIONS:,} random observations"

    def _success(self) -> list[str]:
        if self.figures:
            return list(self.figures)
        if self.success is None:
            if self.description.manifest is None:
                return ["Not measured."]
            task = task_of(self.description) or "TASK"
            command = _MEASURE.format(name=self.name, file=self.file.name, task=task)
            again = "and export it again with `--transfer transfer.json`."
            return ["Not measured: run", "", "```bash", command, "```", "", again]
        engines = [engine for engine in ENGINES if any(engine == each for each, _ in self.success.shares)]
        lines = [
            "Drives that reached the goal, with the 95 % interval of the rate (Wilson):",
            "",
            f"| conditions | {' | '.join(ENGINES[engine] for engine in engines)} |",
            "|---" * (len(engines) + 1) + "|",
        ]
        for condition in self.success.conditions:
            cells = [str(self.success.shares.get((engine, condition), "")) for engine in engines]
            lines.append(f"| {condition} | {' | '.join(cells)} |")
        return [*lines, "", self.success.origin]

    def _limits(self) -> list[str]:
        lines = [f"- {remark}" for remark in self.description.remarks]
        if self.success is not None:
            breaks = self.success.limits()
            told = "Fails more often than in nominal drives, beyond chance, under these conditions:"
            lines.append(f"- {told}" if breaks else "- No measured condition lowers its success beyond chance.")
            lines += [f"    - {each}" for each in breaks]
        lines.append("- Measured in simulation only." if self.success or self.figures else "- Nothing was measured.")
        return lines

    def _outputs(self) -> list[str]:
        network = self.description.network
        return [
            f"Input `observation`: {network.size} numbers. Outputs, in order: "
            + ", ".join(f"`{name}`" for name in network.heads)
            + "."
        ]

    def _use(self) -> list[str]:
        if self.description.manifest is None:
            return [f"Open `{self.name}.onnx` with any ONNX runtime; the node `policy` does not drive by it."]
        start = "ros2 run ctrl_rl_core policy --ros-args -p policy:="
        own = [f"{start}{self.name}"] if self.shipped else []
        return ["```bash", *own, f"{start}{self.name}.onnx  # with {self.name}.yaml beside it", "```"]


def _licence() -> str:
    """Return the licence of the suite, from the workspace's package or from the wheel."""
    for package in ("ctrl_rl_core", "ctrl_rl"):
        with suppress(PackageNotFoundError):
            found = metadata(package)
            return str(next(found[key] for key in ("License-Expression", "License") if key in found))
    return NOT_RECORDED


def _observation(manifest: PolicyManifest) -> list[str]:
    lines = [
        "In order; each value is clipped, then mapped to (value - middle) / unit.",
        "",
        "| value | clipped to | middle | unit |",
        "|---|---|---|---|",
    ]
    for part in manifest.observation:
        spread = [part.spread(name) for name in ("low", "high", "middle", "unit")]
        rows = [_ranges(part)] if isinstance(part, ScanPart) else [f"{part.source}: `{name}`" for name in part.names]
        for index, what in enumerate(rows):
            low, high, middle, unit = (float(values[index]) for values in spread)
            limits = "" if max(abs(low), abs(high)) >= 1e30 else f"{low:g} .. {high:g}"
            lines.append(f"| {what} | {limits} | {middle:g} | {unit:g} |")
    return lines


def _ranges(part: ScanPart) -> str:
    degrees = [math.degrees(bearing) for bearing in (part.bearings[0], part.bearings[-1])]
    within = (
        "nearest beam" if part.half_width == 0.0 else f"{part.reduce} within {math.degrees(part.half_width):.2g} deg"
    )
    where = f"{degrees[0]:.4g} to {degrees[1]:.4g} deg"
    return f"{part.count} ranges at bearings from {where}, {within} [m]"


def _commands(manifest: PolicyManifest) -> list[str]:
    lines = ["| command | lowest | highest |", "|---|---|---|"]
    for (name, unit), low, high in zip(
        COMMANDS[manifest.robot], manifest.action.low, manifest.action.high, strict=True
    ):
        lines.append(f"| `{name}` | {low:g} {unit} | {high:g} {unit} |")
    return lines
