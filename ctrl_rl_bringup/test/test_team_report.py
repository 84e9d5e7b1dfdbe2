"""The verdict of a team's run that was cut off: which robot exceeded which option, and who was refused and why."""

import pytest
from ctrl_rl_bringup.team.report import troubles
from option_coordinator.environments import Span

from ctrl_rl_bringup import TeamRun
from ctrl_rl_msgs.msg import OptionGrant

pytestmark = pytest.mark.fault


def grant(agent: str, option: str = "", reason: str = "") -> OptionGrant:
    status = OptionGrant.REFUSED if reason else OptionGrant.GRANTED
    return OptionGrant(agent=agent, option_name=option, deadline=60.0, status=status, reason=reason)


def test_overruns_and_the_last_refusal_are_named() -> None:
    grants = [
        grant("r1", "desk"),
        grant("r2", "shelf"),
        grant("r1", reason="r1 is given up: it exceeded the maximum duration of 'desk' 2 times in a row"),
        grant("r2", reason="old"),
        grant("r2", reason="the team file differs"),
    ]
    runs = [
        Span("r1", "desk", 0.0, 60.0, True),
        Span("r2", "shelf", 0.0, 12.0, True),
        Span("r1", "desk", 62.0, 122.1, False),
    ]
    assert troubles(grants, runs) == [
        "r1 exceeded the 60 s of 'desk' 2 times",
        "r1 is given up: it exceeded the maximum duration of 'desk' 2 times in a row",
        "r2: the team file differs",
    ]
    assert troubles([grant("r2", "shelf"), grant("r2", reason="the task is over")], runs[1:2]) == []


def test_the_verdict_tells_done_from_cut_off() -> None:
    fields = dict.fromkeys(TeamRun.__dataclass_fields__, ()) | {"duration": 123.4}
    assert TeamRun(**fields | {"finished": True}).verdict == "all work done"
    cut = TeamRun(**fields | {"finished": False, "troubles": ("one", "two")})
    assert cut.verdict == "cut off after 123 s: one; two"
