"""The value grid and the optimal control problem of a task file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from ctrl_rl_core.geometry.units import Interval, Length, TimeStep
from ctrl_rl_core.tasks.schema.parts import Part, Steps, Weight, interval_map
from ctrl_rl_core.tasks.schema.system import CONTROL_UNITS, STATE_UNITS
from ctrl_rl_core.tasks.schema.world import RegionSpec


class GridSpec(Part):
    """One axis of the published value grid: evenly spaced nodes over an interval."""

    interval: str
    count: int = Field(gt=1, le=100_000)


class OptimalControlSpec(Part):
    """Constants of the MPC problem (thesis Eq. 3.16, with the trap term of section 3.3.3).

    Attributes:
        horizon: Number of steps H.
        time_step: Duration of an MPC step [s].
        gamma: Growth factor of the state cost per step.
        discount: Discount factor per policy step, in the value function (Eq. 3.13) and in learning with it.
        state_weight: Weight Q of the squared distance to the goal.
        control_weight: Weight R of the squared controls.
        trap_weight: Weight W of the squared distance to the trap's centre.
        clearance: Minimum distance d_min from the robot's position to an obstacle [m].
        trajectories: Number of solved trajectories in the value data.
        controls: Control bounds by name.
        bounds: State bounds by name.
        terminal_set: Set of states in which a trajectory must end; the goal by default.
    """

    horizon: int = Field(gt=0, le=10_000)
    time_step: TimeStep
    gamma: float = Field(gt=0, le=10)
    discount: float = Field(gt=0, le=1)
    state_weight: Weight
    control_weight: Weight
    trap_weight: float = Field(default=0.0, ge=0, le=1e9)
    clearance: Length
    trajectories: Steps
    controls: Annotated[dict[str, Interval], interval_map(CONTROL_UNITS)]
    bounds: Annotated[dict[str, Interval], interval_map(STATE_UNITS)]
    terminal_set: RegionSpec | None = None
