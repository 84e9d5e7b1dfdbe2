"""The interface of a learnt policy: its observation with order and scale, and the mapping from actions to commands.

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
"""Maximum size of an observation."""
COMMAND_NAMES: Mapping[str, tuple[str, str]] = {
    "differential_drive": ("v", "omega"),
    "planar_quadrotor": ("T_1", "T_2"),
}
"""Commands by kind of robot: speed [m/s] and turn rate [rad/s], or the thrusts of two rotor pairs [N]."""
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
"""Observable components, by kind of robot and source."""
_Numbers = Number | Annotated[list[Number], Field(min_length=1, max_length=LARGEST)]
_Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]


class _Part(Schema):
    """Consecutive values of the observation; a single number applies to all of them.

    Attributes:
        low: Lower clipping bounds.
        high: Upper clipping bounds.
        middle: Values that map to 0.
        unit: Distance from `middle` that maps to 1.
    """

    low: _Numbers = -1e30
    high: _Numbers = 1e30
    middle: _Numbers = 0.0
    unit: _Numbers = 1.0

    @property
    def size(self) -> int:
        """Number of values."""
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
        """Return one of the four attributes as an array with an element per value (size,)."""
        return np.broadcast_to(np.asarray(getattr(self, name), np.float64), self.size)


class NamedPart(_Part):
    """Components selected by name.

    Attributes:
        source: Source of the components. "odometry": pose and speeds in the odometry frame; "pose": the pose from the
            node's pose source; "goal": the goal as given (x, y, theta), or relative to the pose: `bearing` is its
            direction from ahead and `turn` the difference of headings, in [-pi, pi], `ahead` and `left` its coordinates
            in the robot's frame; "command": the last command.
        names: Names of the components, see `KNOWN_NAMES`.
    """

    source: Literal["odometry", "pose", "goal", "command"]
    names: Annotated[list[Annotated[str, Field(max_length=50)]], Field(min_length=1, max_length=100)]

    @property
    def size(self) -> int:
        """Number of values."""
        return len(self.names)


class ScanPart(_Part):
    """Ranges at fixed bearings of the robot, counter-clockwise from ahead.

    Attributes:
        count: Number of bearings.
        first: First bearing [rad].
        step: Angle between bearings [rad].
        at: The bearings [rad], in order around the robot, where they are not evenly spaced: in place of first and step.
        half_width: Half the width of the sector whose beams count for a bearing [rad]; 0 for the nearest beam only.
        reduce: Reduction over several beams: the minimum range or the median.
        low: Minimum range; closer echoes are set to it [m].
        high: Maximum range; farther echoes and missing echoes are set to it [m].
    """

    source: Literal["scan"]
    count: Annotated[int, Field(ge=1, le=1000)]
    first: Annotated[float, Field(ge=-10.0, le=10.0)] = 0.0
    step: Annotated[float, Field(ge=-7.0, le=7.0)] = 0.0
    at: Annotated[list[Annotated[float, Field(ge=-10.0, le=10.0)]], Field(max_length=1000)] | None = None
    half_width: Annotated[float, Field(ge=0.0, le=3.2)] = 0.0
    reduce: Literal["least", "median"] = "least"
    low: Annotated[float, Field(ge=0.0, le=1e4)] = 0.0
    high: Annotated[float, Field(gt=0.0, le=1e4)]

    @property
    def size(self) -> int:
        """Number of values."""
        return self.count

    @property
    def bearings(self) -> Array:
        """The bearings (count,) [rad]."""
        if self.at is not None:
            return np.array(self.at)
        return np.asarray(self.first + self.step * np.arange(self.count), dtype=np.float64)

    @model_validator(mode="after")
    def _described_once(self) -> ScanPart:
        if self.at is not None and (len(self.at) != self.count or self.first or self.step):
            raise ValueError(f"at has {len(self.at)} bearings: must be {self.count}, without first and step")
        return self


Part = Annotated[NamedPart | ScanPart, Field(discriminator="source")]


class ActionSpec(Schema):
    """Mapping from network outputs to a command.

    Attributes:
        low: Command at the minimum action (2,).
        high: Command at the maximum action (2,).
        span: Minimum and maximum action; outputs are clipped to them.
        squash: Function applied to the outputs before clipping.
        choices: Commands (n, 2) of a discrete policy with one output each; the largest output selects the command.
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
                raise ValueError(f"{name}: the minimum must lie below the maximum")
        for choice in self.choices or ():
            if not all(low <= each <= high for low, each, high in zip(self.low, choice, self.high, strict=True)):
                raise ValueError(f"choices: {choice} is not between low and high")
        return self

    @property
    def outputs(self) -> int:
        """Number of network outputs."""
        return 2 if self.choices is None else len(self.choices)

    def command(self, outputs: Array) -> Array:
        """Return the command (2,) for network outputs (outputs,); not finite if the outputs are not."""
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
    """Observation and commands of a policy.

    Attributes:
        robot: Kind of robot, a key of `COMMAND_NAMES`.
        period: Decision period [s]; None to decide at each scan.
        rest: Idle command (2,): 0, or the hover thrusts of a quadrotor.
        observation: Parts of the observation, in order.
        action: Mapping from network outputs to commands.
        largest_distance: Stops the robot when the model's second output is larger: the observation's distance from
            training, relative to the border of what training saw. ONNX models only; None for no such output.
        about: Description of the policy for people.
    """

    robot: Literal["differential_drive", "planar_quadrotor"]
    period: Annotated[Positive, Field(le=60.0)] | None = None
    rest: _Pair = Field(default_factory=lambda: [0.0, 0.0])
    observation: Annotated[list[Part], Field(min_length=1, max_length=100)]
    action: ActionSpec
    largest_distance: Positive | None = None
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
            raise ValueError("rest: a wheeled robot stands at 0 m/s and 0 rad/s: leave it out")
        if flies and not all(thrust > 0.0 for thrust in self.rest):
            raise ValueError("rest: a quadrotor needs its hover thrusts, m g / 2 each [N]")
        return self

    @property
    def size(self) -> int:
        """Size of the observation."""
        return sum(part.size for part in self.observation)

    def observes(self, source: str) -> bool:
        """Return whether the policy observes any component of a source."""
        return any(part.source == source for part in self.observation)
