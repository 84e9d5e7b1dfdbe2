"""Progress where no terminal is."""

import pytest
from ctrl_rl_bringup.runner.monitor import ProgressDisplay


def test_a_log_gets_as_many_lines_as_asked_for_and_the_last_word(capsys: pytest.CaptureFixture[str]) -> None:
    display = ProgressDisplay("driving", lines=4)
    for percent in range(95):
        display.show(percent / 100, f"{percent} s")
    display.close()
    assert capsys.readouterr().err.splitlines() == [
        "driving:  25% of the way, 25 s",
        "driving:  50% of the way, 50 s",
        "driving:  75% of the way, 75 s",
        "driving:  94% of the way, 94 s",
    ]


def test_a_task_without_a_path_has_no_share_of_it(capsys: pytest.CaptureFixture[str]) -> None:
    display = ProgressDisplay("driving", lines=4)
    display.show(float("nan"), "3 s")
    display.close()
    assert capsys.readouterr().err == "driving:   0% of the way, 3 s\n"
