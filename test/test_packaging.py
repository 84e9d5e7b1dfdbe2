"""Each package.xml names what its package imports, by rosdep keys of Ubuntu 24.04, and who keeps it."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from ament_index_python.packages import get_package_prefix

ROOT = Path(__file__).resolve().parents[1]
METHODS = (
    "ttr_reward_node",
    "oc_baseline_node",
    "koopman_lqr_controller",
    "option_coordinator",
    "ctrl_rl_navigation",
    "ctrl_rl_safety",
)
PACKAGES = sorted(file.parent.name for file in ROOT.glob("*/package.xml"))
PYTHON_PACKAGES = [package for package in PACKAGES if package != "ctrl_rl_msgs"]
ROSDEP_KEYS = {
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "matplotlib": "python3-matplotlib",
    "PIL": "python3-pil",
    "pydantic": "python3-pydantic",
    "pytest": "python3-pytest",
    "scipy": "python3-scipy",
    "torch": "python3-torch",
    "tqdm": "python3-tqdm",
    "yaml": "python3-yaml",
}
"""Modules with an apt package in Ubuntu 24.04: ros/rosdistro, rosdep/python.yaml, 2026-08-22 (8468e88)."""
PYPI_ONLY = {
    "apsw": "apsw",
    "casadi": "casadi",
    "gymnasium": "gymnasium",
    "h5py": "h5py",
    "lazy_loader": "lazy_loader",
    "lz4": "lz4",
    "mcap": "mcap",
    "mujoco": "mujoco",
    "pyarrow": "pyarrow",
    "pybullet": "pybullet",
    "rosbags": "rosbags",
    "safetensors": "safetensors",
    "sb3_contrib": "sb3-contrib",
    "stable_baselines3": "stable-baselines3",
    "trimesh": "trimesh",
    "tyro": "tyro",
    "viser": "viser",
    "zstandard": "zstandard",
}
"""Modules that the same list has not, or for pip alone, which Ubuntu 24.04 refuses outside an environment."""
LEARNING = {
    "casadi",
    "dm_control",
    "gymnasium",
    "matplotlib",
    "mujoco",
    "absl",
    "pettingzoo",
    "PIL",
    "ray",
    "sb3_contrib",
    "sklearn",
    "stable_baselines3",
    "torch",
    "warp",
}
"""What only learning, solving for data and figures import in a method package; no robot has it."""
ROS = re.compile(r"rclpy|launch\w*|ament_index_python|\w+_(msgs|srvs|interfaces)|rpyutils|rosidl\w*")


def third_party(package: str) -> set[str]:
    """Return the modules that a robot's part of a package imports from outside ROS, this workspace and Python."""
    found = set()
    for file in (ROOT / package / package).rglob("*.py"):
        if package in METHODS and {"training", "trials"} & set(file.relative_to(ROOT / package).parts):
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(str(node.module).partition(".")[0])
    found -= sys.stdlib_module_names | set(PACKAGES)
    found -= LEARNING if package in METHODS else {"onnx", "onnxruntime", "ray"}
    return {name for name in found if not ROS.fullmatch(name)}


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_package_xml_names_every_import_from_outside_ros(package: str) -> None:
    text = (ROOT / package / "package.xml").read_text(encoding="utf-8")
    named = set(re.findall(r"<(?:exec_)?depend>([\w-]+)<", text))
    comments = " ".join(re.findall(r"<!-- From PyPI only(.*?)-->", text, re.DOTALL))
    used = third_party(package)
    assert used or package == "ctrl_rl"
    assert used <= ROSDEP_KEYS.keys() | PYPI_ONLY.keys(), "say in this test where it comes from"
    assert {ROSDEP_KEYS[name] for name in used & ROSDEP_KEYS.keys()} <= named
    missing = {name for name in used & PYPI_ONLY.keys() if not re.search(rf"\b{PYPI_ONLY[name]}\b", comments)}
    assert not missing, f"{package}/package.xml does not say that {missing} come from PyPI"


@pytest.mark.parametrize("package", PACKAGES)
def test_keys_are_known(package: str) -> None:
    named = re.findall(r"depend>(python3-[\w-]+|[\w-]+-pip)<", (ROOT / package / "package.xml").read_text("utf-8"))
    assert set(named) <= set(ROSDEP_KEYS.values())


@pytest.mark.parametrize("package", PACKAGES)
def test_licence_and_maintainer_are_those_of_the_repository(package: str) -> None:
    root = ET.parse(ROOT / package / "package.xml").getroot()
    assert root.findtext("license") == "Apache-2.0"
    assert (ROOT / "LICENSE").read_text("utf-8").lstrip().startswith("Apache License")
    (maintainer,) = root.findall("maintainer")
    first = ET.parse(ROOT / PACKAGES[0] / "package.xml").getroot().find("maintainer")
    assert first is not None
    assert (maintainer.text, maintainer.get("email")) == (first.text, first.get("email"))


@pytest.mark.parametrize(
    ("package", "executable", "arguments"),
    [
        ("ttr_reward_node", "train", ("--task", "car_ttr")),
        ("oc_baseline_node", "train", ("--task", "car_navigation")),
        ("koopman_lqr_controller", "learn", ("--task", "curved_corridor")),
    ],
)
def test_learning_on_a_robot_says_what_to_install(
    package: str, executable: str, arguments: tuple[str, ...], tmp_path: Path
) -> None:
    absent = re.compile("/(ctrl_rl_learning|sim_bridge)(/|$)")
    kept = [path for path in os.environ["PYTHONPATH"].split(":") if not absent.search(path)]
    program = Path(get_package_prefix(package)) / "lib" / package / executable
    answer = subprocess.run(
        [program, *arguments],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": ":".join(kept)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 1, answer.stdout + answer.stderr
    (line,) = answer.stderr.splitlines()
    assert line.startswith(f"{executable}: needs the package")
    assert "build sim_bridge and ctrl_rl_learning with colcon" in line
