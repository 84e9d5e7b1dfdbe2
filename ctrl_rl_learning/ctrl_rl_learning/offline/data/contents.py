"""What bags hold, in lines: episodes and how they ended, steps, delays, and what was left out or cut."""

from __future__ import annotations

import numpy as np
from ctrl_rl_bags.datasets import Found

from ctrl_rl_core import NavigationTask, Outcome
from ctrl_rl_learning.offline.data.transitions import Transitions


def describe(transitions: Transitions, task: NavigationTask, found: Found) -> list[str]:
    """Return lines on what bags hold for a task, each with a word in front.

    Args:
        transitions: Transitions of the bags.
        task: Task that was driven.
        found: What reading them found.
    """
    step, count = task.episode.time_step, transitions.episode_count
    ends = np.append(np.flatnonzero(transitions.first)[1:] - 1, len(transitions) - 1)
    outcomes = transitions.outcomes[ends]
    ways = [
        f"{(outcomes == outcome).sum()} {'cut' if outcome is Outcome.RUNNING else outcome.words}"
        for outcome in Outcome
        if (outcomes == outcome).any() and outcome is not Outcome.GOAL
    ]
    minutes = len(transitions) * step / 60.0
    lines = [
        f"bags       {count} episodes, {len(transitions)} steps of {step:g} s, {minutes:.1f} min",
        f"ended      success {transitions.success:.0%}{''.join(f', {way}' for way in ways)}",
    ]
    periods, delays = np.array(found.periods), np.array(found.delays)
    if np.isfinite(periods).any():
        late = f"commands come {np.nanmedian(delays):.3f} s after their scan"
        lines.append(f"scans      every {np.nanmedian(periods):.3g} s; {late}")
    if found.left_out:
        lines.append(f"left out   {found.left_out} scans: no odometry or command with them, or outside of an episode")
    if not np.isfinite(transitions.rewards[transitions.outcomes == 0]).any():
        lines.append("rewards    none but the task's at the end of an episode; `relabel` adds them")
    return lines
