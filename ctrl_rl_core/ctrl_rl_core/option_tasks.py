"""The two cooperative tasks with options of thesis chapter 5, as task files."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from ctrl_rl_core.task_parts import Part, TaskHeader
from ctrl_rl_core.units import LengthInterval, Point, PositiveLength, PositiveSpeed, PositiveTime


class ToolDeliveryAgent(Part):
    """One robot: its name, where it starts and, for a Turtlebot, where it waits at the table."""

    name: str
    start: Point
    table_spot: Point | None = None


class ToolDeliveryRewards(Part):
    """What each event pays."""

    step: float
    failed_pass: float
    delivery: float


class ToolDelivery(TaskHeader):
    """A Fetchbot and two Turtlebots bring a human the right tools in time (thesis 5.3.1)."""

    kind: Literal["tool_delivery"]
    room: Point
    workshop: Point
    tool_room: Point
    turtlebots: tuple[ToolDeliveryAgent, ToolDeliveryAgent]
    fetchbot: ToolDeliveryAgent
    time_step: PositiveTime
    step_length: PositiveLength
    stages: int = Field(gt=0)
    stage_steps: int = Field(gt=0)
    tools: tuple[int, ...]
    horizon: int = Field(gt=0)
    pass_steps: int = Field(gt=0)
    search_steps: int = Field(gt=0)
    wait_steps: int = Field(gt=0)
    table_patience: int = Field(gt=0)
    staged_tools: int = Field(gt=0)
    rewards: ToolDeliveryRewards
    training_samples: int = Field(gt=0)
    batch_samples: int = Field(gt=0)

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
    """A slow vehicle and a quick drone keep three jars filled (thesis 5.3.1, Eq. 5.6)."""

    kind: Literal["water_filling"]
    room: tuple[LengthInterval, LengthInterval]
    jars: tuple[Jar, ...] = Field(min_length=1)
    cell: PositiveLength
    time_step: PositiveTime
    vehicle_speed: PositiveSpeed
    drone_speed: PositiveSpeed
    reach: PositiveLength
    start_level: float = Field(ge=0.0, le=1.0)
    interval_means: tuple[int, int]
    drop_divisor: float = Field(gt=0)
    drop_deviation: float = Field(ge=0)
    episode_option_steps: int = Field(gt=0)
    training_samples: int = Field(gt=0)
    batch_samples: int = Field(gt=0)
    level_offset: float = Field(gt=0)
