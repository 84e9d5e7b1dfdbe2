"""The front door: each public name has a runnable example, and the package alone imports nothing heavy."""

import doctest
import importlib
import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import ctrl_rl

EXAMPLES = sorted(name for name in ctrl_rl.__all__ if ">>>" in (getattr(ctrl_rl, name).__doc__ or ""))
FACES = ("solve", "TimeToReachReward", "TimeToReach", "train", "drive", "transitions", "learn_offline", "SafetyShield")


def test_each_face_has_an_example():
    assert set(FACES) <= set(EXAMPLES)
    assert dir(ctrl_rl) == sorted(ctrl_rl.__all__)


def test_each_name_is_on_the_page_of_names():
    page = (Path(__file__).resolve().parents[2] / "docs" / "api.md").read_text("utf-8")
    assert set(re.findall(r"^## ctrl_rl\.(\w+)$", page, re.MULTILINE)) == set(ctrl_rl.__all__)
    for path in re.findall(r"^::: (\S+)$", page, re.MULTILINE):
        module, _, name = path.rpartition(".")
        assert hasattr(importlib.import_module(module), name)


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_gives_what_it_says(name):
    found = getattr(ctrl_rl, name)
    (test,) = doctest.DocTestFinder(recurse=False).find(found, name, globs={})
    warnings.simplefilter("ignore")  # coarse grids are doubtful
    with np.printoptions(legacy=False):
        failed = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(test).failed
    assert failed == 0


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


def test_the_package_alone_imports_nothing_heavy():
    heavy = "{'torch', 'rclpy', 'numba', 'gymnasium', 'casadi', 'pybullet', 'mujoco', 'matplotlib', 'scipy'}"
    answer = run(f"import ctrl_rl, sys; print({heavy} & set(sys.modules))")
    assert answer.stdout == "set()\n", answer.stderr


LITTLE = """
import sys
for name in ("torch", "rclpy", "casadi", "pybullet", "nav_msgs", "ctrl_rl_msgs"):
    sys.modules[name] = None
import ctrl_rl
for name in ("solve", "TimeToReachReward", "SafetyShield", "drive", "transitions", "load_policy"):
    getattr(ctrl_rl, name)
ctrl_rl.load_task("car_ttr")
"""


def test_solving_driving_and_reading_need_no_ros_and_no_torch():
    answer = run(LITTLE)
    assert answer.returncode == 0, answer.stderr


def test_a_missing_extra_is_said_in_one_line():
    answer = run("import sys\nsys.modules['stable_baselines3'] = None\nimport ctrl_rl\nctrl_rl.train")
    assert answer.stderr.splitlines()[-1] == (
        "ImportError: ctrl_rl.train needs stable_baselines3: pip install 'ctrl_rl[learn]'"
    )


def test_a_policy_learns_drives_and_is_saved(tmp_path):
    task = ctrl_rl.load_task("car_ttr")
    value = ctrl_rl.solve(task, counts=(31, 31, 16))
    policy = ctrl_rl.train(task, "ppo", reward=ctrl_rl.TimeToReach(value), samples=2048, episodes=1)
    policy.save(str(tmp_path / "mine.safetensors"))
    saved = ctrl_rl.load_policy(tmp_path / "mine.safetensors")
    bare = ctrl_rl.drive(task, policy, seeds=range(2))
    assert bare.outcomes == ctrl_rl.drive(task, saved, seeds=range(2)).outcomes
    guarded = ctrl_rl.drive(task, policy, seeds=range(2), filter="safety")
    assert not guarded.avoidable.any()
    assert len(guarded) == 2
    with pytest.raises(ctrl_rl.CtrlRlError, match="no filter 'magic'"):
        ctrl_rl.drive(task, policy, filter="magic")
    with pytest.raises(ctrl_rl.CtrlRlError, match="is of the states x, y, theta; here they are x, v_x"):
        ctrl_rl.train("quad_ttr", reward=ctrl_rl.TimeToReach(value))


def test_a_quadrotor_flies_by_its_policy():
    assert len(ctrl_rl.drive("quad_ttr", "quad_ttr", seeds=range(2))) == 2


class Straight:
    """A driver of the test's own."""

    def command(self, sensors):
        assert sensors.goal is not None
        return np.array((0.5, 0.0))


def test_any_driver_and_any_filter_drive():
    hits = ctrl_rl.drive("car_ttr", Straight(), seeds=range(2))
    assert hits.collisions == 1.0
    held = ctrl_rl.drive("car_ttr", Straight(), seeds=range(1), filter=lambda _, command: 0.0 * command)
    assert held.outcomes == ("TIMEOUT",)
    assert held.distances[0] < 0.01
    guarded = ctrl_rl.drive("car_ttr", Straight(), seeds=range(1), filter="safety")
    assert guarded.collisions == 0.0
    assert (guarded.changed > 0.0).all()
    with pytest.raises(ctrl_rl.CtrlRlError, match="object is no policy"):
        ctrl_rl.drive("car_ttr", object())
