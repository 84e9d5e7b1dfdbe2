"""One echo of a chain: answers scans, or the commands of the echo before it, with commands of the same stamp."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))

from _common import echo
from geometry_msgs.msg import TwistStamped
from sensor_msgs.msg import LaserScan

from ctrl_rl_core import COMMAND, SENSOR

if __name__ == "__main__":
    taken, given = sys.argv[1:]
    first = taken == "scan"
    echo(LaserScan if first else TwistStamped, taken, TwistStamped, given, (SENSOR if first else COMMAND, COMMAND))
