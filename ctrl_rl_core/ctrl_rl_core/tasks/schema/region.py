"""Sets of states of a task file."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator

from ctrl_rl_core.geometry.shapes import Disc
from ctrl_rl_core.geometry.units import Interval
from ctrl_rl_core.tasks.regions import Region
from ctrl_rl_core.tasks.schema.parts import Part, interval_map
from ctrl_rl_core.tasks.schema.system import STATE_UNITS
from ctrl_rl_core.tasks.schema.world import DiscSpec


class RegionSpec(Part):
    """A set of states: intervals by state name, and optionally a disc of positions."""

    disc: DiscSpec | None = None
    intervals: Annotated[dict[str, Interval], interval_map(STATE_UNITS)] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _gather(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            raise ValueError("must be a mapping from state names to intervals")
        rest = {name: text for name, text in value.items() if name != "disc"}
        return {"intervals": rest} | ({"disc": value["disc"]} if "disc" in value else {})

    @property
    def region(self) -> Region:
        """The set of states."""
        disc = None if self.disc is None else Disc(self.disc.centre, self.disc.radius)
        return Region(self.intervals, disc)
