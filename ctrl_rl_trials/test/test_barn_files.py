"""The importer reads BARN's and DynaBARN's formats, and refuses everything else in one line."""

import math
import struct
from pathlib import Path

import numpy as np
import pytest
from barn_files import box, cylinder, path_file, plugin, world, write_checkout
from ctrl_rl_trials.barn.drive import LOW_ROS2, score
from ctrl_rl_trials.barn.plugin_file import read_keyframes
from ctrl_rl_trials.barn.scenarios import load_scenario
from ctrl_rl_trials.barn.world_file import read_path, read_world
from ctrl_rl_trials.errors import TrialError
from hypothesis import given
from hypothesis import strategies as st

FRAMES = ((0.0, 0.0, 3.0), (4.0, 1.5, -3.0), (8.0, 0.0, 3.0))


def written(folder: Path, content: str | bytes) -> Path:
    file = folder / "file"
    file.write_bytes(content.encode() if isinstance(content, str) else content)
    return file


def test_a_world_has_its_cylinders_and_walls_and_what_moves(tmp_path: Path) -> None:
    models = cylinder("a", 1.0, 2.0), box("b", 3.0, 4.0, (2.0, 0.5), 0.0), cylinder("c", 0.0, 0.0, 0.4, "move.so")
    found = read_world(written(tmp_path, world(*models)))
    assert [(each.centre, each.radius) for each in found.cylinders] == [((1.0, 2.0), 0.075)]
    assert [(each.centre, each.size) for each in found.boxes] == [((3.0, 4.0), (2.0, 0.5))]
    assert [(each.plugin, each.radius) for each in found.moving] == [("move.so", 0.4)]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("<sdf>", "is not XML"),
        ("<sdf version='1.6'/>", "is not an SDF world"),
        ("<!DOCTYPE a [<!ENTITY b 'c'>]>" + world(), "declares entities"),
        (world(cylinder("a", 1.0, 2.0, lean=0.5)), "is tilted"),
        (world(cylinder("a", math.nan, 2.0)), "its pose must be 6 numbers"),
        (world(cylinder("a", 1.0, 2.0, radius=-1.0)), "its radius must be 1 positive numbers"),
        (world(cylinder("a", 1.0, 2.0, plugin="../move.so")), "its plugin must be a file name"),
        (world("<model name='a'><pose>0 0 0 0 0 0</pose></model>"), "must have exactly one cylinder or box"),
        (b"\xff\xfe", "is not text"),
    ],
)
def test_what_is_no_world_is_refused(tmp_path: Path, content: str | bytes, words: str) -> None:
    with pytest.raises(TrialError, match=words):
        read_world(written(tmp_path, content))


def test_a_path_lies_in_the_world(tmp_path: Path) -> None:
    places = read_path(written(tmp_path, path_file([(0, 0), (10, 20)])))
    np.testing.assert_allclose(places, [(-4.575, 5.075), (-3.075, 8.075)])


@pytest.mark.parametrize(
    "content",
    [b"", b"\x93NUMPY", path_file([1, 2]), path_file([(1, 2)]), path_file([(0, 0), (1e9, 0)]), path_file(["a"])],
)
def test_what_is_no_path_is_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(TrialError):
        read_path(written(tmp_path, content))


def test_key_frames_are_read_from_the_code(tmp_path: Path) -> None:
    found = read_keyframes(written(tmp_path, plugin(FRAMES)))
    assert found.times == (0.0, 4.0, 8.0)
    assert found.points == ((0.0, 3.0), (1.5, -3.0), (0.0, 3.0))


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        (FRAMES[:1], "1 key frames"),
        ((FRAMES[0], FRAMES[2], FRAMES[1]), "times must increase"),
        ((FRAMES[0], (4.0, 50.0, 0.0)), "arena extends"),
        ((FRAMES[0], (4.0, math.nan, 0.0)), "arena extends"),
        ((), "no key frames"),
    ],
)
def test_motions_that_make_no_sense_are_refused(tmp_path: Path, frames: tuple, words: str) -> None:
    with pytest.raises(TrialError, match=words):
        read_keyframes(written(tmp_path, plugin(frames)))


def test_a_plugin_with_endless_names_or_tables_is_refused_soon(tmp_path: Path) -> None:
    """480 kB took 110 s: each of 4,166 symbols was looked up in a name of 280 kB."""
    content = bytearray(b"w" * 480_000)
    content[:6], content[18:20] = b"\x7fELF\x02\x01", struct.pack("<H", 62)
    content[40:48], content[200_000:200_010] = struct.pack("<Q", 64), b"_ZN6gazebo"
    for place in range(70_000, 170_000, 24):
        content[place : place + 24] = struct.pack("<IBBHQQ", 130_000, 0, 0, 0, 0, 5)
    section = struct.pack("<IIQQQQIIQQ", 0, 11, 0, 0, 70_000, 99_984, 0, 0, 0, 0)
    content[64 : 64 + 3 * 64] = 3 * section
    for size, count, words in ((64, 3, "no function Load"), (1, 60_000, "a table of sections")):
        content[58:62] = struct.pack("<HH", size, count)
        with pytest.raises(TrialError, match=words):
            read_keyframes(written(tmp_path, bytes(content)))


@given(st.integers(0, len(plugin(FRAMES)) - 1), st.binary(min_size=1, max_size=8))
def test_a_damaged_plugin_is_refused_or_read(tmp_path_factory: pytest.TempPathFactory, place: int, bits: bytes) -> None:
    folder = tmp_path_factory.mktemp("plugin")
    whole = plugin(FRAMES)
    for content in (whole[:place], whole[:place] + bits + whole[place + len(bits) :]):
        try:
            found = read_keyframes(written(folder, content))
        except TrialError:
            continue
        assert np.isfinite(found.points).all()


def test_worlds_become_tasks(tmp_path: Path) -> None:
    folder = write_checkout(tmp_path)
    static, moving = load_scenario(folder, 0), load_scenario(folder, 300)
    assert len(static.task.obstacles) == 12
    assert static.goal[1] - static.start[1] == 10.0
    assert 10.0 < static.length < 12.0
    (mover,) = moving.task.movers
    assert mover.keyframes is not None
    assert moving.length == 20.0
    for number, words in ((1, "world_1.world"), (360, "there are 0 to 359")):
        with pytest.raises(TrialError, match=words):
            load_scenario(folder, number)
    with pytest.raises(TrialError, match="has no folder worlds"):
        load_scenario(tmp_path / "elsewhere", 0)


def test_the_score_is_the_challenges() -> None:
    assert score(True, 1.0, 10.0) == 0.5
    assert score(True, 10.0, 10.0) == 0.5
    assert score(True, 20.0, 10.0) == 0.25
    assert score(True, 99.0, 10.0) == 0.125
    assert score(False, 5.0, 10.0) == 0.0
    assert score(True, 5.0, 10.0, LOW_ROS2) == 0.25
