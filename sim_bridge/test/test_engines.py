import subprocess
import sys

import pytest

from sim_bridge import SimulationError

SCRIPT = """
import sys
for name in sys.argv[2:]:
    sys.modules[name] = None  # as if it were not installed
from sim_bridge.engines.choice import make_engine
from sim_bridge.errors import SimulationError
try:
    print(type(make_engine(sys.argv[1], 240)).__name__)
except SimulationError as error:
    print(error)
"""


def chosen(name, *missing):
    """Return the engine chosen with missing modules, from standard output, and the lines of standard error."""
    command = [sys.executable, "-c", SCRIPT, name, *missing]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    return run.stdout.strip(), [line for line in run.stderr.splitlines() if line.strip()]


def test_pybullet_is_the_usual_engine():
    pytest.importorskip("pybullet")
    assert chosen("auto") == ("PybulletEngine", [])


def test_where_pybullet_is_missing_mujoco_takes_its_place_and_one_line_says_so():
    assert chosen("auto", "pybullet") == (
        "MujocoEngine",
        ["PyBullet is not installed: the simulation runs in MuJoCo"],
    )


@pytest.mark.parametrize("name", ["pybullet", "mujoco"])
def test_an_engine_that_was_asked_for_by_name_must_be_there(name):
    said, errors = chosen(name, name)
    assert said == f"engine '{name}' is not installed: install {name}, or run with engine auto"
    assert errors == []


def test_an_unknown_engine_is_refused(simulate):
    with pytest.raises(SimulationError, match="there is no engine 'ode': choose one of"):
        simulate("car_ttr", engine="ode")


def test_a_window_is_of_pybullet_alone(simulate, engine):
    if engine == "pybullet":
        pytest.skip("needs a display")
    with pytest.raises(SimulationError, match="no window"):
        simulate("car_ttr", gui=True)
