"""The launch files name executables and parameters that exist; where ROS's launch is installed, it reads them."""

import ast
import os
import runpy
import sys
from pathlib import Path
from typing import Any

import pytest
from ctrl_rl_bringup.runner.processes import executable_path
from ctrl_rl_bringup.runner.stack import DriveConfig, NodeSpec, controller, recorder, simulator, value_nodes
from ctrl_rl_bringup.team.run import TeamConfig, agents, coordinator, team_simulator

from option_coordinator import load_team

FILES = sorted((Path(__file__).parents[1] / "launch").glob("*.launch.py"))
RUNS = [file for file in FILES if "Launch(" in file.read_text()]
"""Those that start a whole run: simulator, recorder, monitor and report as well."""


def name(file: Path) -> str:
    return file.name


def specs() -> list[NodeSpec]:
    """Return one node of each kind that the launch files start."""
    drive, team = DriveConfig(Path("run")), TeamConfig(Path("run"))
    values = {"time_to_reach": Path("grid"), "oc_value": Path("grid")}
    one = [recorder(drive, {}), simulator(drive), controller(drive), *value_nodes(drive, values)]
    robots = load_team(team.team)
    return [*one, coordinator(team), agents(team, robots)[0], team_simulator(team, robots)]


@pytest.mark.parametrize("spec", specs(), ids=lambda spec: spec.name)
def test_each_parameter_is_one_of_the_executable(
    spec: NodeSpec, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = str(executable_path(spec))
    monkeypatch.setattr(sys, "argv", [path, "--help"])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(path, run_name="__main__")
    assert not end.value.code
    told = capsys.readouterr().out
    known = {line.split()[0] for line in told.splitlines() if line.strip()}
    unknown = {parameter for parameter in spec.parameters if not known & {parameter, f"{parameter}:"}}
    assert unknown <= {"use_sim_time"}, told


@pytest.mark.parametrize("file", RUNS, ids=name)
def test_monitor_and_report_are_executables_of_the_package(file: Path) -> None:
    calls = [node for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.Call)]
    (launch,) = (call for call in calls if isinstance(call.func, ast.Name) and call.func.id == "Launch")
    named = {word.arg: word.value for word in launch.keywords}
    for role in ("monitor", "report"):
        command = named[role]
        assert isinstance(command, ast.Tuple)
        assert executable_path(NodeSpec("ctrl_rl_bringup", ast.literal_eval(command.elts[0]))).is_file()


@pytest.fixture
def other_domain(monkeypatch: pytest.MonkeyPatch, file: Path) -> None:
    """A launch keeps its domain until its process ends: let it be none of the other tests', and each file its own."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(102 + (os.getpid() + FILES.index(file)) % 100))


@pytest.mark.usefixtures("other_domain")
@pytest.mark.parametrize("file", FILES, ids=name)
def test_launch_starts_nodes_that_exist(file: Path, tmp_path: Path) -> None:
    launch = pytest.importorskip("launch")
    pytest.importorskip("launch_ros")
    nodes = started(launch, file, tmp_path / "run")
    assert ("ctrl_rl_core", "watchdog") in nodes or ("option_coordinator", "coordinator") in nodes
    for package, executable in nodes:
        assert executable_path(NodeSpec(package, executable)).is_file()
    if file not in RUNS:
        return
    assert {("ctrl_rl_bags", "recorder"), ("sim_bridge", "bridge")} < set(nodes)
    with pytest.raises(Exception, match="at work in ROS domain"):
        started(launch, file, tmp_path / "second")
    assert not (tmp_path / "second").exists()


def started(launch: Any, file: Path, folder: Path) -> list[tuple[str, str]]:
    """Return package and executable of each node that a launch file would start."""
    from launch.launch_description_sources import get_launch_description_from_python_launch_file
    from launch_ros.actions import Node

    context = launch.LaunchContext()
    context.launch_configurations["folder"] = str(folder)
    out = []
    for entity in get_launch_description_from_python_launch_file(str(file)).entities:
        actions = [entity] if isinstance(entity, Node) else entity.execute(context) or []
        out += [(node.node_package, node.node_executable) for node in actions if isinstance(node, Node)]
    return out
