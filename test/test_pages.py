"""The pages work as written: their commands are run one after the other, in a folder of each page's own."""

import os
import signal
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest
from page_table import PAGES, REASONS
from pages import ROOT, begins, blocks, commands, script, to_run

QUICK_S = 30.0
"""Pages that take longer are slow tests."""
_GENERATED = ("docs/results.md",)
_SHELL_WORDS = ("ros2 ", "make ", "pip install", "python ", "source ", "sudo ", "git clone ")


def _texts() -> dict[str, str]:
    """Return all pages by their path in the workspace."""
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return {name: (ROOT / name).read_text(encoding="utf-8") for name in listed.split() if name not in _GENERATED}


TEXTS = _texts()


def test_every_page_with_commands_is_in_the_table() -> None:
    assert {name for name, text in TEXTS.items() if blocks(text)} == set(PAGES)


@pytest.mark.parametrize("name", PAGES)
def test_what_the_table_says_of_a_page_is_there(name: str) -> None:
    page = PAGES[name]
    found = blocks(TEXTS[name])
    parts = [*found, *(command for block in found for command in commands(block))]
    for start, reason in page.skipped.items():
        assert reason in REASONS
        assert begins(next((part for part in parts if part.startswith(start)), ""), page.skipped), f"{start!r} is gone"
    run = to_run(TEXTS[name], page)
    for start in (*page.smaller, *page.between):
        assert any(command.startswith(start) for command in run), f"{start!r} is gone"


@pytest.mark.parametrize("name", TEXTS)
def test_commands_stand_in_fenced_blocks(name: str) -> None:
    lines = TEXTS[name].splitlines()
    hidden = [line for line in lines if line.startswith("    ") and line.strip().startswith(_SHELL_WORDS)]
    fenced = {line for block in blocks(TEXTS[name]) for line in block.splitlines()}
    assert [line for line in hidden if line not in fenced] == []


def _pages() -> list[object]:
    patient = pytest.mark.timeout(3600)
    chosen = {name: page for name, page in PAGES.items() if to_run(TEXTS[name], page)}
    return [
        pytest.param(name, marks=(patient,) if page.seconds < QUICK_S else (patient, pytest.mark.slow))
        for name, page in chosen.items()
    ]


def end_session(number: int) -> None:
    """Kill what is left of a session: the jobs of its shell are process groups of their own."""
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended meanwhile
            if os.getsid(int(process.name)) == number:
                os.kill(int(process.name), signal.SIGKILL)


@pytest.mark.parametrize("name", _pages())
def test_a_page_works_as_written(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "page"
    folder.mkdir()
    said = tmp_path / "said.txt"  # no pipe, which what it starts in the background would hold open
    with said.open("wb") as log:
        shell = subprocess.Popen(
            ["bash", "-c", script(TEXTS[name], PAGES[name])],
            cwd=folder,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        shell.wait()
    finally:
        end_session(shell.pid)
    assert shell.returncode == 0, said.read_text(errors="replace")
