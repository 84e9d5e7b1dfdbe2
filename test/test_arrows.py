"""Arrows between packages and between their rooms point one way, and a robot imports nothing heavy."""

import ast
import re
import subprocess
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
METHODS = (
    "ttr_reward_node",
    "oc_baseline_node",
    "koopman_lqr_controller",
    "option_coordinator",
    "ctrl_rl_navigation",
    "ctrl_rl_safety",
)
MAY_IMPORT = {
    "ctrl_rl_core": set(),
    "ctrl_rl_bags": {"ctrl_rl_core"},
    "sim_bridge": {"ctrl_rl_core"},
    **{package: {"ctrl_rl_core", "ctrl_rl_bags"} for package in METHODS},
    "ctrl_rl_learning": {
        *("ctrl_rl_core", "ctrl_rl_bags", "sim_bridge", "ttr_reward_node", "oc_baseline_node", "ctrl_rl_navigation"),
    },
    "ctrl_rl_trials": {
        *("ctrl_rl_core", "ctrl_rl_bags", "sim_bridge", "ctrl_rl_learning", "ttr_reward_node", "oc_baseline_node"),
        *("ctrl_rl_navigation", "ctrl_rl_safety"),
    },
    "ctrl_rl": {"ctrl_rl_core", "ttr_reward_node", "ctrl_rl_safety", "ctrl_rl_learning"},
    "ctrl_rl_bringup": {"ctrl_rl_core", "ctrl_rl_bags", "sim_bridge", *METHODS},
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
    "ctrl_rl_bringup.cli.preflight",
    "ctrl_rl_bags.recording.recorder_node",
    "ctrl_rl_bags.cli",
    "ctrl_rl_core.systems.system",
    "ctrl_rl_core.tasks.task",
    "ctrl_rl_core.values.value_grid",
    "ctrl_rl_core.ros.value_server",
    "ctrl_rl_core.driving.watchdog_node",
    "ctrl_rl_core.policies.policy_node",
    "ctrl_rl_core.policies.onnx_policy",
    "ctrl_rl_navigation.nodes.navigator_node",
    "ctrl_rl_safety.nodes.safety_filter_node",
    "oc_baseline_node.node",
    "koopman_lqr_controller.nodes.controller_node",
    "koopman_lqr_controller.nodes.scripted_driver_node",
    "koopman_lqr_controller.cli.edmd",
    "koopman_lqr_controller.cli.compare",
    "koopman_lqr_controller.cli.analyse",
    "koopman_lqr_controller.cli.offline",
    "koopman_lqr_controller.cli.learn",
    "option_coordinator.nodes.option_agent",
    "option_coordinator.cli",
    "option_coordinator.nodes.navigation_agent",
    "option_coordinator.nodes.coordinator_node",
    "option_coordinator.policies.policy_file",
    "option_coordinator.environments.tasks",
    "ttr_reward_node.cli.values",
    "ttr_reward_node.nodes.reward_node",
)


@cache
def imports(file: Path) -> list[ast.Import | ast.ImportFrom]:
    """Return the imports of a file, wherever they stand."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]


@cache
def imports_of(file: Path) -> set[str]:
    found = set()
    for node in imports(file):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add(str(node.module).partition(".")[0])
    return found


def sources(package: str) -> list[Path]:
    return sorted((ROOT / package / package).rglob("*.py"))


def module_of(file: Path) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts[1:]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(file): file for package in MAY_IMPORT for file in sources(package)}


def room_of(module: str) -> str:
    """Return the subpackage that a module lies in; `training` of a method package has rooms of its own."""
    parts = module.split(".")
    nested = len(parts) > 2 and parts[0] in METHODS and parts[1] == "training"
    return ".".join(parts[: 3 if nested else 2])


@cache
def modules_imported(file: Path) -> set[str]:
    found = set()
    for node in imports(file):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            submodules = {f"{node.module}.{alias.name}" for alias in node.names} & MODULES.keys()
            found |= submodules or {node.module}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found & MODULES.keys()


@cache
def arrows() -> dict[str, set[str]]:
    """Return which rooms each room imports from."""
    out: dict[str, set[str]] = {}
    for module, file in MODULES.items():
        room = room_of(module)
        out.setdefault(room, set()).update(room_of(other) for other in modules_imported(file) if room_of(other) != room)
    return out


def test_no_arrow_between_rooms_runs_in_a_circle() -> None:
    TopologicalSorter(arrows()).prepare()  # raises CycleError, which names the circle


def runs_on_a_robot(file: Path) -> bool:
    """Tell whether a robot needs a file: learning and the commands that start it are for other machines."""
    package, *rooms = file.relative_to(ROOT).parts[1:]
    return package not in METHODS or not {"training", "trials", "cli"} & set(rooms)


def test_what_runs_on_a_robot_imports_no_training_and_no_simulation() -> None:
    for package in METHODS:
        for file in filter(runs_on_a_robot, sources(package)):
            imported = modules_imported(file)
            rooms = tuple(f"{package}.{room}" for room in ("training", "trials.", "cli"))
            above = {name for name in imported if name.startswith(rooms)}
            assert not above, f"{file.relative_to(ROOT)} imports {sorted(above)}"


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_the_first_level_of_a_package_is_one_look(package: str) -> None:
    files = [file for file in (ROOT / package / package).iterdir() if file.is_file()]
    assert len(files) <= 12, sorted(file.name for file in files)


def test_a_circle_is_found() -> None:
    with pytest.raises(CycleError):
        TopologicalSorter({**arrows(), "ctrl_rl_core.errors": {"ctrl_rl_bringup.cli"}}).prepare()


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_packages_import_only_what_lies_before_them(package: str) -> None:
    assert sources(package)
    for file in sources(package):
        ours = imports_of(file) & set(MAY_IMPORT) - {package}
        allowed = MAY_IMPORT[package]
        if not runs_on_a_robot(file):
            allowed = allowed | {"sim_bridge", "ctrl_rl_learning"}
        assert ours <= allowed, f"{file.relative_to(ROOT)} imports {ours - allowed}"


@pytest.mark.parametrize("room", ["study", "torch", "sb3"])
def test_what_all_learners_share_knows_no_method(room: str) -> None:
    for file in sorted((ROOT / "ctrl_rl_learning" / "ctrl_rl_learning" / room).rglob("*.py")):
        assert not imports_of(file) & set(METHODS), f"{file.relative_to(ROOT)}: what it needs is handed to it"


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_package_xml_names_every_ros_package_that_is_imported(package: str) -> None:
    text = (ROOT / package / "package.xml").read_text(encoding="utf-8")
    named = set(re.findall(r"<(?:exec_|build_)?depend>(\w+)<", text)) | {package}
    used = set().union(*(imports_of(file) for file in sources(package) if runs_on_a_robot(file)))
    ros = {name for name in used if name in MAY_IMPORT or ROS_PACKAGE.fullmatch(name)}
    assert ros <= named, f"{package}/package.xml lacks {sorted(ros - named)}"
    assert package not in METHODS or not named & {"ctrl_rl_learning", "sim_bridge"}, "a robot's install has neither"


IMPORT_ALL = """
import importlib, sys
for module in sys.argv[1:]:
    before = set(sys.modules)
    importlib.import_module(module)
    print(module, *sorted({name.partition(".")[0] for name in set(sys.modules) - before}))
"""


def test_what_runs_on_a_robot_imports_nothing_heavy() -> None:
    command = [sys.executable, "-c", IMPORT_ALL, *RUN_TIME_MODULES]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    loads = {line.split()[0]: HEAVY.intersection(line.split()[1:]) for line in answer.stdout.splitlines()}
    assert {module: heavy for module, heavy in loads.items() if heavy} == {}
    assert set(loads) == set(RUN_TIME_MODULES)


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


PLACES = (*sorted(MAY_IMPORT), "test", "examples", "scripts", "docs", "README.md", "conftest.py")
IMPORT = re.compile(
    rf"\b(?:from|import) ({'|'.join(MAY_IMPORT)})((?:\.\w+)+)(?: import (?:\(([^)]*)\)|([^\n;]*)))?", re.ASCII
)
"""An import, wherever it stands: in code, in the code that a test hands to a process, in a page or a notebook."""


def deep_imports(place: str) -> list[str]:
    """Return imports that pass the faces of other packages: of a file in a room, or of a private name."""
    command = ["git", "ls-files", "--", place]
    files = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    found = []
    for file in files:
        if file.endswith((".py", ".md", ".ipynb")) and (ROOT / file).is_file():
            for line in IMPORT.finditer((ROOT / file).read_text(encoding="utf-8")):
                names = re.findall(r"\w+", line[3] or line[4] or "")
                if line[1] != place and passes_the_face(f"{line[1]}{line[2]}", names):
                    found.append(f"{file}: {' '.join(line[0].split())}")
    return found


def passes_the_face(module: str, names: list[str]) -> bool:
    """Tell whether an import from another package is one of a file in a room, or of a private name."""
    exported = {alias.name for node in imports(MODULES[module]) for alias in node.names} if module in MODULES else set()
    files = {name for name in names if f"{module}.{name}" in MODULES}
    return module.count(".") > 1 or bool(files - exported) or any(name.startswith("_") for name in names)


@pytest.mark.parametrize("place", PLACES)
def test_other_packages_are_imported_by_their_faces(place: str) -> None:
    assert deep_imports(place) == []


FACES = [
    ".".join(file.relative_to(ROOT).parts[1:-1])
    for package in MAY_IMPORT
    for file in sorted((ROOT / package / package).rglob("__init__.pyi"))
]


@pytest.mark.parametrize("face", FACES)
def test_a_face_has_what_its_stub_names(face: str) -> None:
    stub = ast.parse((ROOT / face.split(".")[0]).joinpath(*face.split("."), "__init__.pyi").read_text(encoding="utf-8"))
    module = import_module(face)
    for node in stub.body:
        assert isinstance(node, ast.ImportFrom), ast.unparse(node)
        names = [str(alias.asname or alias.name) for alias in node.names]
        assert not {name for name in names if f"{face}.{name}" in MODULES}, "a module hides a name of the face"
        assert set(names) <= set(dir(module))
