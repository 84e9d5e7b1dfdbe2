"""Shorter episodes of the control suite and fewer candidates, for tests."""

from koopman_lqr_controller.training.consolidation.consolidation_config import ConsolidationConfig
from koopman_lqr_controller.training.consolidation.distillation import DistillationSettings
from koopman_lqr_controller.training.environments.control_suite import ControlSuite

STEPS = 25
"""Actions per episode of the cart-pole, instead of 125."""


def shorten(patch=setattr) -> None:
    """Shorten the episodes of all environments created from now on."""
    make = ControlSuite.__init__

    def make_short(self, *args, **kwargs) -> None:
        make(self, *args, **kwargs)
        self._suite._step_limit = 8 * STEPS

    patch(ControlSuite, "__init__", make_short)


def shorten_consolidation(patch=setattr) -> None:
    """Use fewer and smaller candidates and fewer rounds, unless the command sets them."""
    make, small = ConsolidationConfig.of, DistillationSettings(hidden=32, updates=1000)
    few = {"rounds": 1, "exploratory_latent": 4, "sizes": (4, 6), "distillation": small, "thorough": small}
    patch(ConsolidationConfig, "of", lambda *args, **kwargs: make(*args, **{**few, **kwargs}))
