"""The launch file's executables exist, and every topic of the RViz view has a publisher."""

import ast
from pathlib import Path

import yaml
from ament_index_python.packages import get_package_prefix

FOLDER = Path(__file__).parents[1]
LAUNCH = FOLDER / "launch" / "navigation.launch.py"
BRINGUP = FOLDER.parent / "ctrl_rl_bringup" / "launch" / "robot.launch.py"
SAFETY = FOLDER.parent / "ctrl_rl_safety" / "launch" / "safety_filter.launch.py"
TOPICS = {"/map", "/navigator/slice", "/path", "/scan", "/robot_description", "/walls", "/initialpose", "/goal_pose"}


def test_the_launch_file_starts_executables_of_the_workspace() -> None:
    tree = ast.parse(LAUNCH.read_text())
    started = []
    for call in ast.walk(tree):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "Node":
            named = {word.arg: word.value for word in call.keywords}
            started.append((ast.literal_eval(named["package"]), ast.literal_eval(named["executable"])))
    assert ("ctrl_rl_navigation", "navigator") in started
    for package, executable in started:
        if package != "rviz2":
            assert (Path(get_package_prefix(package)) / "lib" / package / executable).is_file()


def names(file: Path, variable: str) -> set[str]:
    """Return the keys or entries of a launch file's dictionary or tuple."""
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == variable:
            assert isinstance(node.value, ast.Dict | ast.Tuple)
            found = node.value.keys if isinstance(node.value, ast.Dict) else node.value.elts
            return {ast.literal_eval(each) for each in found if each is not None}
    raise AssertionError(f"{file.name} has no {variable}")


def test_launch_files_hand_on_arguments_that_the_included_ones_have() -> None:
    assert names(LAUNCH, "_FILTER") | names(LAUNCH, "_IN_THE_OPEN") <= names(SAFETY, "ARGUMENTS")
    assert names(BRINGUP, "_FILTER") <= names(SAFETY, "ARGUMENTS")
    assert {"filter", "mover_speed"} < names(BRINGUP, "_NAVIGATION") <= names(LAUNCH, "ARGUMENTS")
    assert names(LAUNCH, "_FILTER") <= names(LAUNCH, "ARGUMENTS")


def test_the_view_shows_what_is_published() -> None:
    view = yaml.safe_load((FOLDER / "config" / "navigation.rviz").read_text())["Visualization Manager"]
    shown = {entry["Topic"]["Value"] for entry in (*view["Displays"], *view["Tools"]) if "Topic" in entry}
    shown |= {entry["Description Topic"]["Value"] for entry in view["Displays"] if "Description Topic" in entry}
    assert shown == TOPICS
