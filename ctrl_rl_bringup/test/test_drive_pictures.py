"""Pictures of a recorded drive and of a team."""

import numpy as np
from ctrl_rl_bringup.corridor.surroundings import FilterRecord, MoverTrack
from option_coordinator.environments import Span
from picture_faults import assert_clean

from ctrl_rl_bringup import DriveReport, TeamConfig, TeamRun, draw_drive, draw_team
from ctrl_rl_core import load_navigation_task
from option_coordinator import load_team


def test_a_drive_and_a_team(drawn, tmp_path):
    times = np.linspace(0.0, 20.0, 101)
    path = load_navigation_task("curved_corridor").build_world().path
    truth = np.column_stack((times, path.pose(times / 5.0)[:, :2]))
    columns = np.column_stack((times, 0.2 + 0.0 * times, np.sin(times)))
    mover = MoverTrack(0.15, np.column_stack((times, 2.0 - 0.1 * times, 0.0 * times)))
    record = FilterRecord(times, np.where(times > 10.0, 2, 1), columns[:, 1:], 0.5 * columns[:, 1:], 0.1 + 0.0 * times)
    report = DriveReport(
        "curved_corridor", None, 1, 20.0, 0, 0.1, truth, truth, columns[:, :2], columns, columns, columns[:, [0, 2]],
        np.array([0.01]), 100, 0, columns, None, (mover,), record,
    )  # fmt: skip
    draw_drive(report, tmp_path / "path.png")
    team = load_team("delivery_team")
    names = tuple(team.robots)
    spans = tuple(Span(name, option, 10.0 * k, 10.0 * k + 9.0, k < 2)
                  for name in names for k, option in enumerate(list(team.options)[:3]))  # fmt: skip
    paths = {name: np.column_stack((np.linspace(-1.0, 1.0, 20), np.full(20, 0.3 * k))) for k, name in enumerate(names)}
    run = TeamRun(names, "spread", spans, True, 30.0, 9, 30.0, {}, paths, 0.1, np.array([0.01]), 10, 0)
    draw_team(run, load_navigation_task(TeamConfig(tmp_path).task), team, tmp_path / "team.png")
    assert_clean(drawn)
