"""The page in a headless browser beside the real simulator and navigator: goals by click, and visitors who may not."""

import math
import re
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from signal import SIGINT

import numpy as np
import pytest
import yaml
from browser import CHROMIUM, Browser, send_as_intruder
from commands import start as start_command
from ctrl_rl_navigation.cli import TASK_NAME, task_content

from ctrl_rl_core import OccupancyMap

pytestmark = [
    pytest.mark.slow,
    pytest.mark.realtime,
    pytest.mark.skipif(not CHROMIUM, reason="there is no Chromium: apt install chromium"),
    pytest.mark.skipif(find_spec("viser") is None, reason="viser is not installed: requirements/view.txt"),
]

TOKEN = "swordfish99"
FLOOR = (540.0, 400.0)
"""A pixel of the floor on the side of the room that the robot does not start on."""


def floor(folder: Path) -> Path:
    """Write a map of a room with a post in its middle, and a task on it; return the task."""
    cells = np.zeros((44, 64), np.int8)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:], cells[17:25, 28:36] = (100,) * 5
    OccupancyMap(cells, 0.05).save(folder / "room.yaml")
    task = folder / f"{TASK_NAME}.yaml"
    task.write_text(yaml.safe_dump(task_content(folder / "room.yaml", (0.5, 1.0, 0.5)), sort_keys=False))
    return task


@pytest.fixture
def address(run_node: Callable, tmp_path: Path) -> Iterator[str]:
    """Start simulator, navigator and page, and give its address."""
    run_node("sim_bridge", "bridge", f"task:={floor(tmp_path)}", "engine:=planar", "speed_factor:=3.0")
    run_node("ctrl_rl_navigation", "navigator", "use_sim_time:=true")
    view = start_command("view", "--port", "0", "--token", TOKEN)
    assert view.stdout is not None
    yield view.stdout.readline().split()[1]
    view.send_signal(SIGINT)
    output, errors = view.communicate(timeout=60.0)
    assert (view.returncode, output, errors) == (0, "", "")


@pytest.fixture
def open_page(address: str, tmp_path: Path) -> Iterator[Callable[[], Browser]]:
    opened: list[Browser] = []

    def run() -> Browser:
        folder = tmp_path / f"browser{len(opened)}"
        folder.mkdir()
        opened.append(Browser(folder, address))
        return opened[-1]

    yield run
    for browser in opened:
        browser.close()


def pose(text: str) -> tuple[float, float]:
    found = re.search(r"pose (-?[\d.]+) m, (-?[\d.]+) m", text)
    assert found, text
    return float(found[1]), float(found[2])


def test_a_click_drives_the_robot_of_who_has_the_token_and_of_nobody_else(
    open_page: Callable[[], Browser], address: str
) -> None:
    page = open_page()
    page.wait_for("waiting for a goal")
    begin = pose(page.text())
    page.click(*FLOOR)
    page.fill("token", "swordfish98")
    page.press("Unlock")
    page.wait_for("This is not the token.")
    assert "Stop" not in page.text().splitlines()
    assert " sent\n" not in page.text()
    assert math.dist(pose(page.text()), begin) < 0.05

    page.fill("token", TOKEN)
    page.press("Unlock")
    page.wait_for("click on the floor")
    time.sleep(1.0)  # until the scene knows that clicks count
    page.click(*FLOOR)
    page.wait_for(") sent")
    told = re.search(r"goal \((-?[\d.]+), (-?[\d.]+)\) sent", page.text())
    assert told
    goal = float(told[1]), float(told[2])
    assert math.dist(goal, begin) > 1.0
    page.wait_for("the goal is reached", 300.0)
    assert math.dist(pose(page.text()), goal) < 0.25

    stop, go = (page.evaluate(f"[...document.querySelectorAll('button')].find((b) => b.innerText === '{label}').id")
                for label in ("Stop", "Go"))  # fmt: skip
    send_as_intruder(address, stop, go)
    time.sleep(2.0)
    text = page.text()
    assert told[0] in text
    assert "stop:" not in text
    assert "the goal is reached" in text

    page.press("Stop")
    page.wait_for("stop: there is no goal")
