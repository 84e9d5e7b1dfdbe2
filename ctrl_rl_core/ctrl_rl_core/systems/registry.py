"""System models by name: the suite's own, those registered by a program, and those of installed packages.

A package offers a `SystemModel` with an entry point in its setup.py or pyproject.toml:

    entry_points={"ctrl_rl.systems": ["tricycle = my_package.tricycle:TRICYCLE"]}

A task file then refers to it by `system: {model: tricycle}`, which makes it available to solver, MPC, simulator and
training.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from ctrl_rl_core.errors import CtrlRlError
from ctrl_rl_core.plugins import find_plugins, load_plugin
from ctrl_rl_core.systems.models import SYSTEM_MODELS, SystemModel

GROUP = "ctrl_rl.systems"


class SystemModelError(CtrlRlError):
    """An unknown system, parameter or component, an invalid number, or arrays of the wrong shape."""


def find_model(name: str) -> SystemModel:
    """Return a system model by its name.

    Raises:
        SystemModelError: The model is unknown, or its package cannot be loaded.
    """
    if name not in SYSTEM_MODELS:
        offered = find_plugins(GROUP)
        if name not in offered:
            known = ", ".join((*SYSTEM_MODELS, *offered))
            raise SystemModelError(f"unknown system '{name[:60]}'; choose one of {known}")
        SYSTEM_MODELS[name] = load_plugin(offered[name], SystemModel, "system", SystemModelError)
    return SYSTEM_MODELS[name]


class StateUnits(Mapping[str, str]):
    """Units of the states of all loaded models, and of path coordinates along a corridor."""

    _PATH: Mapping[str, str] = {"s": "m", "lateral": "m", "heading": "rad"}

    def _units(self) -> dict[str, str]:
        return {state.name: state.unit for model in SYSTEM_MODELS.values() for state in model.states} | dict(self._PATH)

    def __getitem__(self, name: str) -> str:
        """Return the unit of a component."""
        return self._units()[name]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names."""
        return iter(self._units())

    def __len__(self) -> int:
        """Return the number of names."""
        return len(self._units())


class ControlUnits(StateUnits):
    """Units of the controls of all loaded models."""

    def _units(self) -> dict[str, str]:
        return {control.name: control.unit for model in SYSTEM_MODELS.values() for control in model.controls}
