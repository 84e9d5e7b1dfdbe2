"""The configuration of twist_mux, which is not on PyPI: its shape, and that the guide shows its place."""

import re
from pathlib import Path

import yaml

PACKAGE = Path(__file__).parents[1]
SETTINGS = yaml.safe_load((PACKAGE / "config" / "twist_mux.yaml").read_text())["twist_mux"]["ros__parameters"]
GUIDE = (PACKAGE.parent / "docs" / "tutorials" / "burger_guide.md").read_text()


def test_it_takes_stamped_commands_and_each_source_times_out() -> None:
    assert SETTINGS["use_stamped"] is True
    for source in SETTINGS["topics"].values():
        assert set(source) == {"topic", "timeout", "priority"}
        assert 0.0 < source["timeout"] <= 0.5


def test_hands_win_over_policies_and_the_emergency_stop_over_all() -> None:
    priorities = {name: source["priority"] for name, source in SETTINGS["topics"].items()}
    assert priorities["joystick"] > priorities["keyboard"] > priorities["policy"]
    assert SETTINGS["locks"]["emergency_stop"]["priority"] > max(priorities.values())
    assert max(SETTINGS["locks"]["emergency_stop"]["priority"], *priorities.values()) <= 255


def test_the_guide_uses_its_topics_and_puts_it_before_the_watchdog() -> None:
    for source in (*SETTINGS["topics"].values(), *SETTINGS["locks"].values()):
        assert re.search(rf"\b{source['topic']}\b", GUIDE)
    assert "cmd_vel_out:=cmd_vel_raw" in GUIDE
