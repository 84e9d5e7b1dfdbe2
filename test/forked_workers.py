"""Workers of pytest-xdist that begin with their imports done: one process makes those of all tests, and is forked.

Each worker would import ROS, torch, Numba and the suite anew, which takes it some ten seconds.
"""

import subprocess
from pathlib import Path

import pytest
from preloaded import Preloaded


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(config: pytest.Config) -> None:
    """Let execnet, with which pytest-xdist starts its workers, fork them."""
    from execnet import gateway_base, gateway_io

    places = [Path(argument.partition("::")[0]) for argument in config.args]
    files = [file for place in places for file in ([place] if place.is_file() else place.rglob("test_*.py"))]
    files.append(Path(__file__).with_name("later_imports.py"))

    class Worker(Preloaded):
        sources = files

    class Streams(gateway_io.Popen2IOMaster):
        def __init__(self, args: list[str], execmodel: gateway_base.ExecModel) -> None:
            *_, option, code = args  # before them stand the interpreter and -u
            self.popen = worker = Worker([option, code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            gateway_base.Popen2IO.__init__(self, worker.stdin, worker.stdout, execmodel)

    gateway_io.Popen2IOMaster = Streams
