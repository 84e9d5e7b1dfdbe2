"""The launch file's executables exist, and its topics form the chain from the driver to the robot."""

import ast
from pathlib import Path

from ament_index_python.packages import get_package_prefix

FILE = Path(__file__).parents[1] / "launch" / "safety_filter.launch.py"


def test_filter_and_watchdog_form_a_chain() -> None:
    renamed = {}
    for call in ast.walk(ast.parse(FILE.read_text())):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "Node":
            named = {word.arg: word.value for word in call.keywords}
            package, executable = ast.literal_eval(named["package"]), ast.literal_eval(named["executable"])
            assert (Path(get_package_prefix(package)) / "lib" / package / executable).is_file()
            renamed[executable] = dict(ast.literal_eval(named["remappings"]))
    assert renamed == {"safety_filter": {"cmd_vel": "cmd_vel_safe"}, "watchdog": {"cmd_vel_raw": "cmd_vel_safe"}}
