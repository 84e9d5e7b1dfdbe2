"""The arrows between packages point one way, and what runs on a robot imports nothing heavy."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
METHODS = ("ttr_reward_node", "oc_baseline_node", "koopman_lqr_controller", "option_coordinator")
MAY_IMPORT = {
    "ctrl_rl_core": set(),
    "sim_bridge": {"ctrl_rl_core"},
    "ctrl_rl_training": {"ctrl_rl_core", "sim_bridge"},
    **{package: {"ctrl_rl_core"} for package in METHODS},
    "ctrl_rl_bringup": {"ctrl_rl_core", "sim_bridge", *METHODS},
}
ROS_PACKAGE = re.compile(r"rclpy|launch\w*|ament_index_python|\w+_(msgs|srvs|interfaces)")
HEAVY = {
    "torch",
    "pybullet",
    "pybullet_data",
    "casadi",
    "gymnasium",
    "pettingzoo",
    "stable_baselines3",
    "sb3_contrib",
    "matplotlib",
    "mujoco",
    "dm_control",
}
RUN_TIME_MODULES = (
    "ctrl_rl_core.recorder_node",
    "ctrl_rl_core.bag_cli",
    "ctrl_rl_core.systems",
    "ctrl_rl_core.tasks",
    "ctrl_rl_core.value_grid",
    "ctrl_rl_core.value_server",
    "ctrl_rl_core.watchdog_node",
    "ctrl_rl_training.actor",
    "koopman_lqr_controller.node",
    "koopman_lqr_controller.scripted_driver_node",
    "koopman_lqr_controller.two_stage_cli",
    "koopman_lqr_controller.training.compare_cli",
    "koopman_lqr_controller.analysis_cli",
    "koopman_lqr_controller.offline_cli",
    "koopman_lqr_controller.training_cli",
    "option_coordinator.agent",
    "option_coordinator.cli",
    "option_coordinator.navigation_agent",
    "option_coordinator.node",
    "option_coordinator.policy_file",
    "option_coordinator.tasks",
    "ttr_reward_node.cli",
    "ttr_reward_node.node",
)


def imports_of(file: Path) -> set[str]:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add(str(node.module).partition(".")[0])
    return found


def sources(package: str) -> list[Path]:
    return sorted((ROOT / package / package).rglob("*.py"))


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_packages_import_only_what_lies_before_them(package: str) -> None:
    assert sources(package)
    for file in sources(package):
        ours = imports_of(file) & set(MAY_IMPORT) - {package}
        allowed = MAY_IMPORT[package]
        if package in METHODS and ("training" in file.stem or file.parent.name == "training"):
            allowed = allowed | {"sim_bridge", "ctrl_rl_training"}
        assert ours <= allowed, f"{file.relative_to(ROOT)} imports {ours - allowed}"


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_package_xml_names_every_ros_package_that_is_imported(package: str) -> None:
    text = (ROOT / package / "package.xml").read_text(encoding="utf-8")
    named = set(re.findall(r"<(?:exec_|build_)?depend>(\w+)<", text)) | {package}
    used = set().union(*(imports_of(file) for file in sources(package)))
    ros = {name for name in used if name in MAY_IMPORT or ROS_PACKAGE.fullmatch(name)}
    assert ros <= named, f"{package}/package.xml lacks {sorted(ros - named)}"


@pytest.mark.parametrize("module", RUN_TIME_MODULES)
def test_what_runs_on_a_robot_imports_nothing_heavy(module: str) -> None:
    code = f"import sys, {module}; print(' '.join(sys.modules))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=os.environ, check=False)
    assert answer.returncode == 0, answer.stderr
    loaded = {name.partition(".")[0] for name in answer.stdout.split()}
    assert not loaded & HEAVY


def test_every_package_is_a_colcon_package_of_the_right_kind() -> None:
    answer = subprocess.run(
        [
            sys.executable,
            "-m",
            "colcon",
            "list",
            "--base-paths",
            *(str(ROOT / name) for name in (*MAY_IMPORT, "ctrl_rl_msgs")),
        ],
        capture_output=True,
        text=True,
        check=True,
    )
    kinds = {line.split()[0]: line.split()[-1].strip("()") for line in answer.stdout.splitlines()}
    assert kinds == {"ctrl_rl_msgs": "ros.ament_cmake", **dict.fromkeys(MAY_IMPORT, "ros.ament_python")}
