"""A driver of one's own drives in the simulator and in a node, as the page says."""

import re
import subprocess
import sys
from pathlib import Path

from preloaded import Preloaded

PAGE = Path(__file__).resolve().parents[1] / "docs" / "howto" / "own_driver.md"


def test_the_page_works_as_written(tmp_path: Path) -> None:
    driver, node = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert "range(5)" in driver
    (tmp_path / "gap.py").write_text(driver.replace("range(5)", "range(2)"), encoding="utf-8")
    (tmp_path / "gap_node.py").write_text(node, encoding="utf-8")
    (tmp_path / "one_scan.py").write_text(_ONE_SCAN, encoding="utf-8")

    def run(script: str, *words: str) -> str:
        pipe = subprocess.PIPE
        process = Preloaded(
            [sys.executable, tmp_path / script, *words], cwd=tmp_path, stdout=pipe, stderr=pipe, text=True
        )
        said, errors = process.communicate()
        assert process.returncode == 0, errors
        return said

    assert run("gap.py").startswith("2 episodes: 2 GOAL")
    assert "Drives towards the side with more room." in run("gap_node.py", "--help")
    assert run("one_scan.py").split() == ["moves"]


_ONE_SCAN = """
import math
from ctrl_rl_core.ros import initialise
from gap_node import GapNode
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan
initialise(["gap"])
node = GapNode()
odometry = Odometry()
odometry.pose.pose.orientation.w = 1.0
scan = LaserScan(angle_increment=math.tau / 90, angle_max=math.tau * 89 / 90, range_min=0.1, range_max=8.0)
scan.ranges = [3.0] * 90
node.robot.hear_odometry(odometry)
node.robot.hear_scan(scan)
print("moves" if node.robot.moving else "stands", node.robot.problem)
"""
