"""Atomic file writing."""

import pytest
from ctrl_rl_core.io.atomic_write import is_temporary

from ctrl_rl_core import atomic_write


def test_text_and_bytes_replace_what_was_there(tmp_path):
    file = tmp_path / "file"
    atomic_write(file, "längs")
    assert file.read_bytes() == "längs".encode()
    atomic_write(file, b"\x00\x01")
    assert file.read_bytes() == b"\x00\x01"
    assert list(tmp_path.iterdir()) == [file]


def test_what_cannot_be_written_leaves_nothing_behind(tmp_path):
    folder = tmp_path / "folder"
    (folder / "kept").mkdir(parents=True)
    with pytest.raises(OSError, match="folder") as refused:
        atomic_write(folder, "over a folder")
    assert refused.value.filename == str(folder)
    missing = tmp_path / "none" / "file"
    with pytest.raises(FileNotFoundError) as refused:
        atomic_write(missing, "in no folder")
    assert refused.value.filename == str(missing), "not the temporary one, which nobody knows"
    assert list(tmp_path.iterdir()) == [folder]
    assert (folder / "kept").is_dir()


def test_temporary_files_are_told_from_others(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr("os.fsync", lambda _: seen.extend(tmp_path.iterdir()))
    atomic_write(tmp_path / "file.json", "text")
    assert [is_temporary(file) for file in seen] == [True]
    assert not any(is_temporary(tmp_path / name) for name in ("file.json", ".hidden", ".a.tmp", "a.12.tmp"))


def test_what_a_killed_run_left_is_in_nobodys_way(tmp_path, monkeypatch):
    """In a container, every run has the same process id."""

    def killed(_: int) -> None:
        raise KeyboardInterrupt

    file = tmp_path / "file"
    with monkeypatch.context() as patched:
        patched.setattr("os.fsync", killed)
        patched.setattr("pathlib.Path.unlink", lambda *_, **__: None)
        with pytest.raises(KeyboardInterrupt):
            atomic_write(file, "old")
    assert [is_temporary(left) for left in tmp_path.iterdir()] == [True]
    atomic_write(file, "new")
    assert file.read_text() == "new"
