"""Any file-system object in place of a file is read completely or rejected in one line, without blocking."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from ctrl_rl_core.io import checked_arrays, checked_json, checked_tensors, checked_yaml
from ctrl_rl_core.io.file_checks import LONGEST_ERROR, FileError, one_line, open_file, raise_as, read_bytes, short_repr
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from ctrl_rl_core import CtrlRlError

pytestmark = pytest.mark.fault


class OwnError(CtrlRlError):
    pass


def pipe(folder: Path) -> Path:
    os.mkfifo(folder / "pipe")
    return folder / "pipe"


def sparse(folder: Path) -> Path:
    with (folder / "sparse").open("wb") as file:
        file.truncate(10**12)
    return folder / "sparse"


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (pipe, "is no regular file"),
        (sparse, "is too large: 1,000,000,000,000 bytes, at most 1,000 are read"),
        (lambda folder: folder, "is a folder"),
        (lambda _: Path("/dev/zero"), "is no regular file"),
        (lambda folder: folder / "none", "there is no such file"),
        (lambda folder: folder / "n\0ne", "is not the name of a file"),
        (lambda folder: folder / ("n" * 300), "cannot be read: File name too long"),
    ],
)
def test_what_is_no_file_of_a_sensible_size_is_not_read(tmp_path: Path, make, words: str) -> None:
    path = make(tmp_path)
    with pytest.raises(OwnError, match=words) as error, raise_as(OwnError, path):
        read_bytes(path, 1000)
    assert "\n" not in str(error.value)


def test_a_home_is_a_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "mine").write_bytes(b"12")
    assert read_bytes("~/mine", 10) == b"12"


@given(st.text(alphabet=st.characters(codec=None), max_size=2000))
def test_every_text_becomes_one_line_that_can_be_printed(text: str) -> None:
    line = one_line(text)
    assert line.isprintable()
    assert line.splitlines() in ([], [line])
    assert len(line.encode()) <= 10 * LONGEST_ERROR
    assert len(short_repr(text)) <= 600


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 1000, "nested more than 40 levels"),
        ('{"a":' * 100_000, "nested more than 40 levels"),
        ('{"a": 1, "b": 2, "a": 3}', "has the key 'a' twice"),
        ("{" + ", ".join(['"a": 1'] * 100_000) + "}", "has the key 'a' twice"),
        ('{"a": ' + "9" * 5000 + "}", "a number of 5000 digits"),
        ('{"a": "\\ud800"}', "half of a character"),
        ('"' + '\\"' * 200_000, "not valid JSON"),
        ('{"a": 1', "not valid JSON"),
    ],
)
def test_json_that_would_hang_or_burst_is_refused(text: str, words: str) -> None:
    with pytest.raises(FileError, match=words):
        checked_json.parse_json(text)


def test_json_keeps_its_digest_however_it_is_laid_out(tmp_path: Path) -> None:
    file, content = tmp_path / "mine.json", {"b": [1.5, 1e-300], "a": "ä"}
    file.write_text(json.dumps(checked_json.with_digest(content), indent=4, sort_keys=True))
    assert checked_json.read_json(file) == content
    file.write_text(file.read_text().replace("1.5", "2.5"))
    with pytest.raises(FileError, match="does not match its digest"):
        checked_json.read_json(file)


def test_a_file_without_a_digest_is_read_and_told_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = tmp_path / "old.json"
    file.write_text('{"a": 1}')
    assert [checked_json.read_json(file), checked_json.read_json(file)] == [{"a": 1}, {"a": 1}]
    assert [record.getMessage() for record in caplog.records] == [
        f"{file}: has no digest of all of it, as an earlier version wrote it: damage may go unnoticed"
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: &a [x]\nb: *a\n", "has an alias in line 2"),
        (
            "a: &a [l, l]\n" + "".join(f"{c}: &{c} [*{p}, *{p}]\n" for p, c in zip("abcdef", "bcdefg", strict=True)),
            "alias",
        ),
        ("<<: {a: 1}\n", r"has a merge \(<<\) in line 1"),
        ("a: 1\na: 2\n", "key 'a' stands twice, the second time in line 2"),
        ("[" * 1000, "nested more than 40 levels"),
        ("a: " + "- " * 1000 + "b", "nested more than 40 levels|not valid YAML"),
        ("? [a]\n: 1\n", "a key that is a list|not valid YAML"),
        (f"a: {'9' * 5000}\n", "not valid YAML"),
        ("a: !!python/object/apply:os.system [ls]\n", "not valid YAML"),
        ("a: 2026-99-99\n", "not valid YAML"),
        ("a: " + "x" * 30_000, "a text of 30,000 characters"),
        ("a: \x00", "not valid YAML"),
    ],
)
def test_yaml_that_would_hang_or_burst_is_refused(text: str, words: str) -> None:
    with pytest.raises(FileError, match=words):
        checked_yaml.parse_yaml(text.encode())


def tensors(folder: Path) -> Path:
    path = folder / "mine.safetensors"
    content = {"w": np.arange(12, dtype=np.float32).reshape(3, 4), "n": np.arange(3, dtype=np.int64)}
    path.write_bytes(checked_tensors.encode_tensors(content, "mine", {"format": 1, "zeros": "0" * 64}))
    return path


def test_every_flipped_bit_of_a_file_of_tensors_is_noticed(tmp_path: Path) -> None:
    path = tensors(tmp_path)
    content = path.read_bytes()
    header, there, digest = checked_tensors.read_tensors(path, "mine", types=("F32", "I64"), with_digest=True)
    assert header == {"format": 1, "zeros": "0" * 64}
    assert there["w"][2].tolist() == [8.0, 9.0, 10.0, 11.0]
    assert re.fullmatch("[0-9a-f]{64}", digest)
    key = content.index(b'\\"sha256')  # a key of another name is an unknown key, which is the schema's to refuse
    taken = []
    for bit in range(8 * len(content)):
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        try:
            header, _, _ = checked_tensors.read_tensors(path, "mine", types=("F32", "I64"))
        except (CtrlRlError, ValidationError):
            continue
        taken.append((bit // 8, header))
    assert all(key <= place < key + 11 for place, _ in taken)
    assert all(set(header) != {"format", "zeros"} for _, header in taken)


def test_tensors_are_checked_before_they_are_allocated(tmp_path: Path) -> None:
    path = tmp_path / "huge.safetensors"
    entry = {"dtype": "F64", "shape": [10**6, 10**6], "data_offsets": [0, 8 * 10**12]}
    header = json.dumps({"__metadata__": {"mine": "{}"}, "w": entry}).encode()
    path.write_bytes(len(header).to_bytes(8, "little") + header)
    with pytest.raises(FileError, match="not a whole safetensors file"):
        checked_tensors.read_tensors(path, "mine")
    with path.open("r+b") as file:
        file.truncate(8 + len(header) + 8 * 10**12)
    for largest in (None, checked_tensors.LARGEST):
        with pytest.raises(FileError, match="is too large"):
            checked_tensors.read_tensors(path, "mine", largest=largest)


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_none_are_refused(tmp_path: Path, number: float) -> None:
    path = tmp_path / "mine.safetensors"
    path.write_bytes(checked_tensors.encode_tensors({"w": np.array([0.0, number])}, "mine", {}))
    with pytest.raises(FileError, match="not all numbers of 'w' are finite"):
        checked_tensors.read_tensors(path, "mine")


def archive(folder: Path, **arrays: np.ndarray) -> Path:
    path = folder / "mine.npz"
    path.write_bytes(
        checked_arrays.encode_arrays({"x": np.arange(6.0).reshape(2, 3), "names": np.array(["a", "b"]), **arrays})
    )
    return path


def test_arrays_come_back_and_every_flipped_bit_of_them_is_noticed(tmp_path: Path) -> None:
    path = archive(tmp_path)
    there = checked_arrays.read_arrays(path, ("x", "names"), 10_000)
    assert there["x"].tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]
    assert there["names"].tolist() == ["a", "b"]
    content = path.read_bytes()
    for bit in range(0, 8 * len(content), 3):
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        try:
            again = checked_arrays.read_arrays(path, ("x", "names"), 10_000)
        except CtrlRlError:
            continue
        assert all(np.array_equal(again[name], there[name]) for name in there)  # a bit that means nothing, as a date


def test_archives_that_burst_are_not_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    np.savez_compressed(path, x=np.zeros(2_000_000), names=np.array(["a"]))
    assert path.stat().st_size < 100_000
    with pytest.raises(FileError, match="too large"):
        checked_arrays.read_arrays(path, ("x", "names"), 1_000_000)


def test_archives_of_something_else_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.npz"
    np.savez(path, x=np.array([{"a": 1}], dtype=object), names=np.array(["a"]))
    with pytest.raises(FileError, match="x is of type object"):
        checked_arrays.read_arrays(path, ("x", "names"), 10_000)
    np.savez(path, x=np.zeros(3))
    with pytest.raises(FileError, match="lacks 'names'"):
        checked_arrays.read_arrays(path, ("x", "names"), 10_000)
    np.savez(path, x=np.array([np.nan]), names=np.array(["a"]))
    with pytest.raises(FileError, match="not all numbers of x are finite"):
        checked_arrays.read_arrays(path, ("x", "names"), 10_000)


def test_opening_does_not_leak(tmp_path: Path) -> None:
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(20):
        with pytest.raises(FileError), open_file(tmp_path, 10):
            pass
    assert len(os.listdir("/proc/self/fd")) == before
