"""How commands refuse and end."""

import argparse
import os
from pathlib import Path

import pytest
from ctrl_rl_core.command import CommandError, check_least, file_to_write, folder_to_write


def test_numbers_that_are_too_small_are_refused_by_name():
    options = argparse.Namespace(seeds=1, roll_outs=0, samples=None)
    check_least(options, seeds=1, roll_outs=0, samples=1)
    with pytest.raises(CommandError, match="--roll-outs must be at least 1, not 0"):
        check_least(options, seeds=1, roll_outs=1)


def test_where_nothing_can_be_written_is_refused_before_any_work(tmp_path: Path):
    there = tmp_path / "there.json"
    there.write_text("{}")
    assert file_to_write(str(there)) == there  # is replaced
    assert file_to_write(str(tmp_path / "new" / "r.json")).name == "r.json"
    assert folder_to_write(str(tmp_path / "new" / "deeper")).name == "deeper"
    assert not (tmp_path / "new").exists()
    with pytest.raises(argparse.ArgumentTypeError, match="is a folder: name a file in it"):
        file_to_write(str(tmp_path))
    for wrong in (lambda: folder_to_write(str(there)), lambda: file_to_write(str(there / "r.json"))):
        with pytest.raises(argparse.ArgumentTypeError, match=r"there\.json is a file: name a folder"):
            wrong()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_may_not_be_written_to_is_refused(tmp_path: Path):
    tmp_path.chmod(0o500)
    with pytest.raises(argparse.ArgumentTypeError, match="may not be written to"):
        folder_to_write(str(tmp_path / "new"))
