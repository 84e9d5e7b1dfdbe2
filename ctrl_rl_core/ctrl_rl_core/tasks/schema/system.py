"""The system model of a task file, for solvers and model predictive control."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import Field, model_validator

from ctrl_rl_core.geometry.units import parse_interval, parse_scalar
from ctrl_rl_core.systems.registry import ControlUnits, StateUnits, SystemModelError, find_model
from ctrl_rl_core.systems.system import System, make_system
from ctrl_rl_core.tasks.schema.parts import Part, unit_of

STATE_UNITS = StateUnits()
"""Units of the states of system models, and of path coordinates along a corridor."""
CONTROL_UNITS = ControlUnits()
"""Units of the controls of system models."""


class SystemSpec(Part):
    """The robot's model f for solvers and MPC (thesis Table 3.1).

    Attributes:
        model: Name of a model in `ctrl_rl_core.SYSTEM_MODELS`, or of a model of an installed package.
        parameters: Parameters by name, with units; the model's defaults otherwise.
        controls: Bounds by control name; the model's defaults otherwise.
        states: Bounds by state name, within which the state must stay; the model's own by default.
    """

    model: str
    parameters: dict[str, str] = Field(default_factory=dict)
    controls: dict[str, str] = Field(default_factory=dict)
    states: dict[str, str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _known(self) -> SystemSpec:
        try:
            find_model(self.model)
        except SystemModelError as error:
            raise ValueError(f"model: {error}") from None
        self.build()
        return self

    def scaled(self, factors: Mapping[str, float]) -> SystemSpec:
        """Return the same model with some parameters scaled, by name.

        Raises:
            ValueError: The model has no such parameter, or the resulting value is invalid.
        """
        units = {name: unit_of(name, self._parameter_units()) for name in factors}
        own = self.build().parameters
        changed = {name: f"{factor * own[name]!r} {units[name]}" for name, factor in factors.items()}
        parameters = {**self.parameters, **changed}
        return SystemSpec(model=self.model, parameters=parameters, controls=self.controls, states=self.states)

    def _parameter_units(self) -> dict[str, str]:
        return {parameter.name: parameter.unit for parameter in find_model(self.model).parameters}

    def build(self) -> System:
        """Create the system model with this task's parameters and bounds."""
        model = find_model(self.model)
        parameter_units = self._parameter_units()
        control_units = {control.name: control.unit for control in model.controls}
        parameters = {
            name: parse_scalar(text, unit_of(name, parameter_units)) for name, text in self.parameters.items()
        }
        controls = {name: parse_interval(text, unit_of(name, control_units)) for name, text in self.controls.items()}
        state_units = {state.name: state.unit for state in model.states}
        states = {name: parse_interval(text, unit_of(name, state_units)) for name, text in self.states.items()}
        try:
            return make_system(self.model, parameters=parameters, state_bounds=states, control_bounds=controls)
        except SystemModelError as error:
            raise ValueError(str(error)) from None
