"""Errors and exit codes of commands."""

import os
import select
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
import tyro
from ctrl_rl_core.command import FiniteNumber, Positive, at_least, file_to_write, folder_to_write

from ctrl_rl_core import parse_options


@dataclass
class Rollouts:
    """Roll a policy out."""

    roll_outs: at_least(1)
    """Number of roll-outs."""
    seeds: at_least(1) = 3
    """Number of seeds."""


def test_options_have_defaults_and_help(capsys: pytest.CaptureFixture[str]):
    assert parse_options("roll", Rollouts, ["--roll-outs", "2"]) == Rollouts(2, 3)
    with pytest.raises(SystemExit) as end:
        parse_options("roll", Rollouts, ["--help"])
    shown = capsys.readouterr().out
    assert end.value.code == 0
    assert all(words in shown for words in ("Roll a policy out.", "--seeds INT", "Number of seeds. (default: 3)"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--roll-outs", "0"], "--roll-outs must be a whole number of at least 1, not 0"),
        (["--roll-outs", "1", "--seeds", "two"], "--seeds must be a whole number of at least 1, not two"),
        ([], "missing --roll-outs"),
        (["--roll-outs", "1", "--speed", "2"], "unknown option --speed"),
    ],
)
def test_a_wrong_command_line_is_refused_in_one_line(capsys, arguments: list[str], words: str):
    with pytest.raises(SystemExit) as end:
        parse_options("roll", Rollouts, arguments)
    assert end.value.code == 2
    assert capsys.readouterr().err == f"roll: {words}; see roll --help\n"


@dataclass
class Files:
    """Read files."""

    files: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Files to read."""
    others: tuple[Path, ...] = ()
    """Files that may be missing."""


def test_a_list_that_has_no_default_needs_an_element(capsys: pytest.CaptureFixture[str]):
    assert parse_options("read", Files, ["a", "b"]).files == (Path("a"), Path("b"))
    with pytest.raises(SystemExit) as end:
        parse_options("read", Files, [])
    assert end.value.code == 2
    assert capsys.readouterr().err == "read: missing files; see read --help\n"


def test_where_nothing_can_be_written_is_refused_before_any_work(tmp_path: Path):
    there = tmp_path / "there.json"
    there.write_text("{}")
    assert file_to_write(str(there)) == there  # is replaced
    assert file_to_write(str(tmp_path / "new" / "r.json")).name == "r.json"
    assert folder_to_write(str(tmp_path / "new" / "deeper")).name == "deeper"
    assert not (tmp_path / "new").exists()
    with pytest.raises(ValueError, match="is a folder: name a file in it"):
        file_to_write(str(tmp_path))
    for wrong in (lambda: folder_to_write(str(there)), lambda: file_to_write(str(there / "r.json"))):
        with pytest.raises(ValueError, match=r"there\.json is a file: name a folder"):
            wrong()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_may_not_be_written_to_is_refused(tmp_path: Path):
    tmp_path.chmod(0o500)
    with pytest.raises(ValueError, match="may not be written to"):
        folder_to_write(str(tmp_path / "new"))


@dataclass(frozen=True)
class _Options:
    """Do something."""

    starts: Positive = 3
    """Number of starts."""
    sweeps: Positive | None = None
    """Number of sweeps; no limit where none is given."""
    width: FiniteNumber | None = None
    """Width of the corridor [m]; the task's own where none is given."""


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--starts", "0"], "--starts must be a whole number of at least 1, not 0"),
        (["--sweeps", "0"], "--sweeps must be a whole number of at least 1, not 0"),
        (["--sweeps", "few"], "--sweeps must be a whole number of at least 1, not few"),
        (["--width", "nan"], "--width 'nan' is not a finite number"),
        (["--wide", "1"], "unknown option --wide"),
    ],
)
def test_wrong_usage_is_one_line_whether_or_not_an_option_may_be_left_out(words, reason, capsys):
    with pytest.raises(SystemExit) as ended:
        parse_options("do", _Options, words)
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"do: {reason}; see do --help\n"


def test_options_that_may_be_left_out_are_read():
    assert parse_options("do", _Options, []) == _Options()
    assert parse_options("do", _Options, ["--sweeps", "4", "--width", "0.5"]) == _Options(3, 4, 0.5)


def test_each_line_leaves_at_once_into_a_pipe() -> None:
    work = "lambda: print('on') or len(sys.stdin.read())"
    code = f"import sys; from ctrl_rl_core.command import run_command; run_command('test', {work})"
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONUNBUFFERED"}
    process = subprocess.Popen(
        [sys.executable, "-c", code], env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert process.stdin is not None
    assert process.stdout is not None
    with process:
        assert select.select([process.stdout], [], [], 60.0)[0], "nothing was printed while the command works"
        assert process.stdout.readline() == "on\n"
        process.stdin.close()
