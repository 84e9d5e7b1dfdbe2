"""The interface of a learnt policy: what it observes, in which order and scale, and how its actions become commands.

The manifest is stored in the header of an actor's file, or as YAML beside an ONNX model:

    robot: differential_drive
    period: 0.2
    observation:
      - {source: scan, count: 24, step: 0.2618, low: 0.12, high: 3.5, unit: 3.5}
      - {source: goal, names: [distance, bearing]}
    action: {low: [0.0, -1.0], high: [0.2, 1.0]}

All quantities are in SI units. Each observed value is clipped to `low` .. `high`, then
normalised to (value - middle) / unit.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from ctrl_rl_core.io.schema import Number, Positive, Schema

Array = NDArray[np.float64]

LARGEST = 10_000
"""Numbers that an observation may have."""
COMMAND_NAMES: Mapping[str, tuple[str, str]] = {
    "differential_drive": ("v", "omega"),
    "planar_quadrotor": ("T_1", "T_2"),
}
"""Commands by the kind of robot: speed [m/s] and turn rate [rad/s], or the thrusts of two rotor pairs [N]."""
KNOWN_NAMES: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "differential_drive": {
        "odometry": ("x", "y", "theta", "v", "omega"),
        "pose": ("x", "y", "theta", "cos_theta", "sin_theta"),
        "goal": (
            *("x", "y", "theta", "distance", "bearing", "cos_bearing", "sin_bearing"),
            *("ahead", "left", "turn"),
        ),
        "command": COMMAND_NAMES["differential_drive"],
    },
    "planar_quadrotor": {
        "odometry": ("x", "z", "psi", "v_x", "v_z", "omega"),
        "command": COMMAND_NAMES["planar_quadrotor"],
    },
}
"""Components that may be observed, by kind of robot and source."""
_Numbers = Number | Annotated[list[Number], Field(min_length=1, max_length=LARGEST)]
_Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]


class _Part(Schema):
    """Values that follow each other in the observation; a single number counts for all of them.

    Attributes:
        low: Least values that are told apart.
        high: Largest values that are told apart.
        middle: Values that become 0.
        unit: Distance above the middle that becomes 1.
    """

    low: _Numbers = -1e30
    high: _Numbers = 1e30
    middle: _Numbers = 0.0
    unit: _Numbers = 1.0

    @property
    def size(self) -> int:
        """Count of values."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _fits(self) -> _Part:
        for name in ("low", "high", "middle", "unit"):
            value = getattr(self, name)
            if isinstance(value, list) and len(value) != self.size:
                raise ValueError(f"{name} has {len(value)} numbers: must be one, or {self.size}")
        if not (self.spread("low") <= self.spread("high")).all():
            raise ValueError("low must not lie above high")
        if not (self.spread("unit") > 0.0).all():
            raise ValueError("unit must be above 0")
        return self

    def spread(self, name: str) -> Array:
        """Return one of the four numbers for each value (size,)."""
        return np.broadcast_to(np.asarray(getattr(self, name), np.float64), self.size)


class NamedPart(_Part):
    """Components by name.

    Attributes:
        source: Where they come from. "odometry": pose and speeds in the frame of the odometry; "pose": the pose by
            the node's source of poses; "goal": the goal as it was given (x, y, theta), or as seen from the pose, where
            `bearing` is its direction from ahead and `turn` the difference of headings, in [-pi, pi], `ahead` and
            `left` its coordinates in the robot's frame; "command": the last command.
        names: Names of the components, see `KNOWN_NAMES`.
    """

    source: Literal["odometry", "pose", "goal", "command"]
    names: Annotated[list[Annotated[str, Field(max_length=50)]], Field(min_length=1, max_length=100)]

    @property
    def size(self) -> int:
        """Count of values."""
        return len(self.names)


class ScanPart(_Part):
    """Ranges at fixed bearings of the robot, counter-clockwise from ahead.

    Attributes:
        count: Number of bearings.
        first: First bearing [rad].
        step: Angle from bearing to bearing [rad].
        half_width: Half the opening in which beams count for a bearing [rad]; 0 for the nearest beam alone.
        reduce: Which of several beams counts: the least range, or the median.
        low: Least range; what is too close reads it [m].
        high: Largest range; what is farther, and nothing there, reads it [m].
    """

    source: Literal["scan"]
    count: Annotated[int, Field(ge=1, le=1000)]
    first: Annotated[float, Field(ge=-10.0, le=10.0)] = 0.0
    step: Annotated[float, Field(ge=-7.0, le=7.0)] = 0.0
    half_width: Annotated[float, Field(ge=0.0, le=3.2)] = 0.0
    reduce: Literal["least", "median"] = "least"
    low: Annotated[float, Field(ge=0.0, le=1e4)] = 0.0
    high: Annotated[float, Field(gt=0.0, le=1e4)]

    @property
    def size(self) -> int:
        """Count of values."""
        return self.count

    @property
    def bearings(self) -> Array:
        """The bearings (count,) [rad]."""
        return np.asarray(self.first + self.step * np.arange(self.count), dtype=np.float64)


Part = Annotated[NamedPart | ScanPart, Field(discriminator="source")]


class ActionSpec(Schema):
    """How the outputs of a network become a command.

    Attributes:
        low: Command of the least action (2,).
        high: Command of the largest action (2,).
        span: Least and largest action, at which outputs are cut off.
        squash: Function of the outputs before that.
        choices: Commands (n, 2) of a policy with one output each: the largest output's command is taken.
    """

    low: _Pair
    high: _Pair
    span: _Pair = Field(default_factory=lambda: [-1.0, 1.0])
    squash: Literal["none", "tanh"] = "none"
    choices: Annotated[list[_Pair], Field(min_length=2, max_length=1000)] | None = None

    @model_validator(mode="after")
    def _in_order(self) -> ActionSpec:
        for name, low, high in (("low", self.low, self.high), ("span", self.span[:1], self.span[1:])):
            if not all(least < most for least, most in zip(low, high, strict=True)):
                raise ValueError(f"{name}: the least must lie below the largest")
        for choice in self.choices or ():
            if not all(low <= each <= high for low, each, high in zip(self.low, choice, self.high, strict=True)):
                raise ValueError(f"choices: {choice} is not between low and high")
        return self

    @property
    def outputs(self) -> int:
        """Count of a network's outputs."""
        return 2 if self.choices is None else len(self.choices)

    def command(self, outputs: Array) -> Array:
        """Return the command (2,) of a network's outputs (outputs,); not finite where they are not."""
        if self.choices is not None:
            return np.array(self.choices[int(np.argmax(outputs))]) if np.isfinite(outputs).all() else np.full(2, np.nan)
        action = np.tanh(outputs) if self.squash == "tanh" else outputs
        least, most = self.span
        share = (np.clip(action, least, most) - least) / (most - least)
        low, high = self._bounds
        return low + share * (high - low)

    @cached_property
    def _bounds(self) -> tuple[Array, Array]:
        return np.array(self.low), np.array(self.high)


class PolicyManifest(Schema):
    """What a policy takes and gives.

    Attributes:
        robot: Kind of robot, a key of `COMMAND_NAMES`.
        period: Time between two decisions [s]; None to decide at each scan.
        rest: Command of a robot that has nothing to do (2,): 0, or the thrusts that carry a quadrotor.
        observation: Parts of the observation, in order.
        action: Mapping from the network's outputs to commands.
        about: Description of the policy for people.
    """

    robot: Literal["differential_drive", "planar_quadrotor"]
    period: Annotated[Positive, Field(le=60.0)] | None = None
    rest: _Pair = Field(default_factory=lambda: [0.0, 0.0])
    observation: Annotated[list[Part], Field(min_length=1, max_length=100)]
    action: ActionSpec
    about: Annotated[str, Field(max_length=1000)] = ""

    @model_validator(mode="after")
    def _of_the_robot(self) -> PolicyManifest:
        flies = self.robot == "planar_quadrotor"
        for index, part in enumerate(self.observation):
            if isinstance(part, ScanPart):
                continue
            known = KNOWN_NAMES[self.robot].get(part.source)
            if known is None:
                raise ValueError(f"observation.{index}: a {self.robot} has no {part.source}: use odometry")
            unknown = [name for name in part.names if name not in known]
            if unknown:
                raise ValueError(f"observation.{index}: {part.source} has no '{unknown[0]}': it has {', '.join(known)}")
        if self.size > LARGEST:
            raise ValueError(f"observation: has {self.size} numbers, at most {LARGEST} are taken")
        if not flies and any(self.rest):
            raise ValueError("rest: a robot on wheels stands at 0 m/s and 0 rad/s: leave it out")
        if flies and not all(thrust > 0.0 for thrust in self.rest):
            raise ValueError("rest: a quadrotor needs the thrusts that carry it, m g / 2 each [N]")
        return self

    @property
    def size(self) -> int:
        """Count of observed values."""
        return sum(part.size for part in self.observation)

    def observes(self, source: str) -> bool:
        """Return whether the policy observes something of a source."""
        return any(part.source == source for part in self.observation)
