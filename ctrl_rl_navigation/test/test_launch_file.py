"""The launch file's executables exist, and every topic of the RViz view has a publisher."""

import ast
from pathlib import Path

import yaml
from ament_index_python.packages import get_package_prefix

FOLDER = Path(__file__).parents[1]
TOPICS = {"/map", "/navigator/slice", "/path", "/scan", "/robot_description", "/walls", "/initialpose", "/goal_pose"}


def test_the_launch_file_starts_executables_of_the_workspace() -> None:
    tree = ast.parse((FOLDER / "launch" / "navigation.launch.py").read_text())
    started = []
    for call in ast.walk(tree):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "Node":
            named = {word.arg: word.value for word in call.keywords}
            started.append((ast.literal_eval(named["package"]), ast.literal_eval(named["executable"])))
    assert ("ctrl_rl_navigation", "navigator") in started
    for package, executable in started:
        if package != "rviz2":
            assert (Path(get_package_prefix(package)) / "lib" / package / executable).is_file()


def test_the_view_shows_what_is_published() -> None:
    view = yaml.safe_load((FOLDER / "config" / "navigation.rviz").read_text())["Visualization Manager"]
    shown = {entry["Topic"]["Value"] for entry in (*view["Displays"], *view["Tools"]) if "Topic" in entry}
    shown |= {entry["Description Topic"]["Value"] for entry in view["Displays"] if "Description Topic" in entry}
    assert shown == TOPICS
