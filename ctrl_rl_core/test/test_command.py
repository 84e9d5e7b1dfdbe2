"""How commands refuse and end."""

import argparse

import pytest
from ctrl_rl_core.command import CommandError, check_least


def test_numbers_that_are_too_small_are_refused_by_name():
    options = argparse.Namespace(seeds=1, roll_outs=0, samples=None)
    check_least(options, seeds=1, roll_outs=0, samples=1)
    with pytest.raises(CommandError, match="--roll-outs must be at least 1, not 0"):
        check_least(options, seeds=1, roll_outs=1)
