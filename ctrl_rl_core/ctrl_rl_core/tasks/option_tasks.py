"""The two cooperative tasks with options of thesis chapter 5, as task files."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, Strict, model_validator

from ctrl_rl_core.geometry.units import LengthInterval, Point, PositiveLength, PositiveSpeed, TimeStep
from ctrl_rl_core.tasks.schema.parts import Part, Reward, Samples, Several, Steps, TaskHeader


class ToolDeliveryAgent(Part):
    """One robot: its name, start, and for a Turtlebot the waiting position at the table."""

    name: str
    start: Point
    table_spot: Point | None = None


class ToolDeliveryRewards(Part):
    """Reward for each event."""

    step: Reward
    failed_pass: Reward
    delivery: Reward


class ToolDelivery(TaskHeader):
    """A Fetchbot and two Turtlebots bring a human the right tools in time (thesis 5.3.1)."""

    kind: Literal["tool_delivery"]
    room: Point
    workshop: Point
    tool_room: Point
    turtlebots: Annotated[tuple[ToolDeliveryAgent, ToolDeliveryAgent], Strict(False)]
    fetchbot: ToolDeliveryAgent
    time_step: TimeStep
    step_length: PositiveLength
    stages: Steps
    stage_steps: Steps
    tools: Several[int] = Field(min_length=1, max_length=100)
    horizon: Steps
    pass_steps: Steps
    search_steps: Steps
    wait_steps: Steps
    table_patience: Steps
    staged_tools: Steps
    rewards: ToolDeliveryRewards
    training_samples: Samples
    batch_samples: Samples

    @model_validator(mode="after")
    def _tools_and_spots(self) -> ToolDelivery:
        if sorted(self.tools) != list(range(len(self.tools))):
            raise ValueError("tools: must number the tools from 0, in the order in which the human needs them")
        if any(robot.table_spot is None for robot in self.turtlebots):
            raise ValueError("turtlebots: each needs a 'table_spot'")
        return self


class Jar(Part):
    """A jar by name and position."""

    name: str
    position: Point


class WaterFilling(TaskHeader):
    """A slow vehicle and a fast drone keep three jars filled (thesis 5.3.1, Eq. 5.6)."""

    kind: Literal["water_filling"]
    room: Annotated[tuple[LengthInterval, LengthInterval], Strict(False)]
    jars: Several[Jar] = Field(min_length=1, max_length=100)
    cell: PositiveLength
    time_step: TimeStep
    vehicle_speed: PositiveSpeed
    drone_speed: PositiveSpeed
    reach: PositiveLength
    start_level: float = Field(ge=0.0, le=1.0)
    interval_means: Annotated[tuple[Steps, Steps], Strict(False)]
    drop_divisor: float = Field(gt=0, le=1e9)
    drop_deviation: float = Field(ge=0, le=1e9)
    episode_option_steps: Steps
    training_samples: Samples
    batch_samples: Samples
    level_offset: float = Field(gt=0, le=1)
