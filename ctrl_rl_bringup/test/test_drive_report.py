"""The words of a drive's report."""

import math
from dataclasses import replace

import numpy as np
from ctrl_rl_bringup.corridor.report import DriveReport

from ctrl_rl_msgs.msg import TaskOutcome

NONE = np.empty((0, 3))
REPORT = DriveReport(
    task="quad_ttr",
    width=None,
    outcome=TaskOutcome.GOAL,
    duration=1.9,
    collisions=0,
    smallest_clearance=0.1,
    truth=NONE,
    odometry=NONE,
    clearance=NONE,
    commands=NONE,
    rewards=np.array(((0.0, -2.7, 2.7), (1.0, -1.3, 1.3))),
    oc_values=NONE,
    latencies=np.ones(3),
    messages=10,
    lost=0,
    predictions=NONE,
    latent=None,
)


def test_a_drive_is_compared_with_the_time_to_reach_where_that_holds_for_its_speeds() -> None:
    assert "time                1.9 s, 0.70 of the time to reach, 2.7 s\n" in REPORT.text()
    fast = replace(REPORT, rewards=np.array(((0.0, -2.7, 2.7), (1.0, math.nan, math.nan))))
    assert "1.9 s; the time to reach is 2.7 s at the speeds of its grid, which the drive left\n" in fast.text()


def test_the_speed_that_was_achieved_is_told_and_whether_the_drive_depended_on_it() -> None:
    assert (
        "speed               1.6 times real time, each command before the next scan\n"
        in replace(REPORT, speed=1.6).text()
    )
    late = replace(REPORT, speed=1.6, late=7)
    assert "1.6 times real time; 7 commands came after the next scan: the drive depended on" in late.text()
    assert (late.as_dict()["speed"], late.as_dict()["late_commands"]) == (1.6, 7)
