"""Which tasks a fleet simulates."""

from pathlib import Path

import pytest
import yaml
from ctrl_rl_learning.sb3 import fits_fleet

from ctrl_rl_core import NavigationTask, load_task, task_file, task_names
from sim_bridge import PlanarFleet, SimulationError


def steered_car(folder: Path) -> str:
    """Write the task of a car with steered wheels."""
    content = yaml.safe_load(task_file("car_navigation").read_text(encoding="utf-8"))
    content |= {"name": "race", "robot": {"body": "race_car"}}
    content["system"]["controls"] = {"v": "0.5 m/s", "omega": "-robot .. robot rad/s"}
    del content["optimal_control"]
    file = folder / "race.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return str(file)


def test_a_task_fits_a_fleet_where_one_can_be_made(tmp_path: Path) -> None:
    tasks = [load_task(name) for name in (*task_names(), steered_car(tmp_path))]
    fit = {True: 0, False: 0}
    for task in tasks:
        if not isinstance(task, NavigationTask):
            continue
        fit[fits_fleet(task)] += 1
        if fits_fleet(task):
            PlanarFleet(task, 2)
        else:
            with pytest.raises(SimulationError, match="a fleet "):
                PlanarFleet(task, 2)
    assert min(fit.values()) > 3, fit
