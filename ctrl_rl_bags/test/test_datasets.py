"""Conversion of bags to datasets of other libraries and back, bitwise equal, read by those libraries' loaders."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bag_messages import OFFICE
from ctrl_rl_bags.cli import main
from ctrl_rl_bags.datasets.conversion import export_bags, import_dataset, read_dataset
from ctrl_rl_bags.datasets.extraction import Found, extract, find_layout
from ctrl_rl_bags.datasets.frames import ScanLayout
from ctrl_rl_bags.datasets.options import ExtractionOptions
from ctrl_rl_bags.datasets.rebuilding import (
    EPISODE_TYPE,
    GOAL_TYPE,
    IMAGE_TYPE,
    ODOMETRY_TYPE,
    REWARD_TYPE,
    SCAN_TYPE,
    MessageMaker,
)

from ctrl_rl_bags import BagError, BagWriter

SCAN = ScanLayout(beams=8, angle_min=-1.5, angle_increment=0.25, range_min=0.125, range_max=10.0, frame="laser")
STEP = 10**8
TWIST = "geometry_msgs/msg/Twist"
FORMATS = {"lerobot": "pyarrow", "minari": "h5py"}


def somewhere(random: np.random.Generator, k: int) -> np.ndarray:
    """Return odometry of a robot driving at about 0.1 m/s, with varied bit patterns in all numbers."""
    numbers = 1e-3 * random.normal(size=13)
    numbers[[0, 6, 7]] += 0.01 * k, 1.0, 0.1
    numbers[3:7] /= np.linalg.norm(numbers[3:7])
    return numbers


def write_drives(folder: Path, lengths=((1005, 1), (9, 2), (7, 4)), camera: bool = True) -> Path:
    """Write a bag as a recorder does: odometry between the scans; each episode is given as (scans, outcome)."""
    make, random, t = MessageMaker(), np.random.default_rng(0), 10**15
    with BagWriter(folder) as bag:
        for name, kind in (
            ("/scan", SCAN_TYPE),
            ("/odom", ODOMETRY_TYPE),
            ("/cmd_vel", TWIST),
            ("/goal_pose", GOAL_TYPE),
            ("/reward", REWARD_TYPE),
            ("/episode", EPISODE_TYPE),
            *((("/camera/image_raw", IMAGE_TYPE),) if camera else ()),
        ):
            bag.add_topic(make.topic(name, kind))
        bag.set_custom_data("digest.task", "0123")
        bag.set_custom_data("parameters./sim_bridge", json.dumps({"task": "mine.yaml"}))
        bag.write("/goal_pose", make.goal(t, somewhere(random, 100)[:7]), t)
        for number, (length, outcome) in enumerate(lengths):
            bag.write("/episode", make.episode(t, number, 0), t)
            for k in range(length + 3):  # the robot goes on for a while after its outcome
                ended = outcome if k >= length else 0
                for part in range(3):
                    bag.write("/odom", make.odometry(t, somewhere(random, k)), t + part)
                    bag.write("/reward", make.reward(t, float(random.normal()), ended), t + part)
                if k == length:
                    bag.write("/episode", make.episode(t, number, outcome), t + 4)
                ranges = random.uniform(0.1, 9.0, 8).astype(np.float32)
                ranges[k % 8] = (np.nan, np.inf, -np.inf)[k % 3]
                if camera and k % 2 == 0:
                    picture = random.integers(0, 256, (4, 6, 3), dtype=np.uint8)
                    bag.write("/camera/image_raw", make.image(t, picture), t + 4)
                bag.write("/scan", make.scan(t, ranges, SCAN), t + 5)
                bag.write("/cmd_vel", make.command(t, random.normal(size=2), TWIST), t + 9)
                t += STEP
    return folder


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    return write_drives(tmp_path_factory.mktemp("drives") / "bag")


def episodes(frames):
    """Return the columns of each episode as bytes and arrays."""
    out: dict[int, dict[str, list]] = {}
    for piece in frames:
        assert all(len(values) == len(piece) for values in piece.columns.values())
        for name, values in piece.columns.items():
            out.setdefault(piece.episode, {}).setdefault(name, []).append(values)
    return [{name: np.concatenate(parts) for name, parts in each.items()} for each in out.values()]


def extracted(folder: Path):
    options = ExtractionOptions()
    return episodes(extract([folder], find_layout(folder, options), options, Found()))


def check_same(ours, theirs) -> None:
    assert len(ours) == len(theirs)
    for one, other in zip(ours, theirs, strict=True):
        assert list(one) == list(other)
        for name, values in one.items():
            assert values.dtype == other[name].dtype
            assert values.shape == other[name].shape
            assert values.tobytes() == other[name].tobytes(), name


def test_frames_are_scans_with_what_was_known_and_what_was_done_then(bag: Path) -> None:
    layout = find_layout(bag, ExtractionOptions())
    assert (layout.task, layout.digests, layout.rate) == ("mine", {"digest.task": "0123"}, 10.0)
    found = Found()
    pieces = list(extract([bag], layout, ExtractionOptions(), found))
    assert max(len(piece) for piece in pieces) <= 1001
    (first, second, third) = episodes(pieces)
    # The scan at which the outcome is known is the last; scans after it are in no frame.
    assert [len(each["stamp"]) for each in (first, second, third)] == [1006, 10, 8]
    assert found.left_out == 6
    assert [each["next.outcome"][-2:].tolist() for each in (first, second, third)] == [[1, 0], [2, 0], [4, 0]]
    assert [int(each["next.done"].sum()) for each in (first, second, third)] == [1, 1, 0]
    assert np.isnan(first["next.reward"][-1])
    assert np.isfinite(first["next.reward"][:-1]).all()
    assert (np.diff(first["log_time"]) == STEP).all()
    assert first["is_last"].tolist() == [False] * 1005 + [True]
    assert (first["action"][-1] == first["action"][-2]).all()


@pytest.mark.parametrize("kind", FORMATS)
def test_a_dataset_and_the_bag_of_it_have_the_same_bits(kind: str, bag: Path, tmp_path: Path) -> None:
    pytest.importorskip(FORMATS[kind])
    more = write_drives(tmp_path / "more", ((8, 1), (5, 2)))
    done = export_bags([bag, more], tmp_path / "set", kind, ExtractionOptions())
    assert (done.episodes, done.frames, done.left_out) == (5, 1024 + 15, 6 + 4)
    layout, frames = read_dataset(tmp_path / "set")
    assert layout == find_layout(bag, ExtractionOptions())
    ours = extracted(bag), extracted(more)
    check_same([*ours[0], *ours[1]], episodes(frames))
    assert import_dataset(tmp_path / "set", tmp_path / "bags").frames == done.frames
    for number in range(2):
        check_same(ours[number], extracted(tmp_path / "bags" / f"bag_{number}"))
        assert find_layout(tmp_path / "bags" / f"bag_{number}", ExtractionOptions()) == layout
    with pytest.raises(BagError, match="exists: name another folder"):
        export_bags([bag], tmp_path / "set", kind, ExtractionOptions())


def test_minari_reads_the_same_bits(bag: Path, tmp_path: Path) -> None:
    minari = pytest.importorskip("minari")
    pytest.importorskip("h5py")
    export_bags([bag], tmp_path / "set", "minari", ExtractionOptions())
    dataset = minari.MinariDataset(tmp_path / "set" / "data")
    assert (dataset.total_episodes, dataset.total_steps) == (3, 1021)
    for mine, episode in zip(extracted(bag), dataset.iterate_episodes(), strict=True):
        for name, values in episode.observations.items():
            assert values.tobytes() == mine[f"observation.{name}"].tobytes(), name
            assert dataset.observation_space[name].shape == values.shape[1:]
        assert episode.actions.tobytes() == mine["action"][:-1].tobytes()
        assert episode.rewards.tobytes() == mine["next.reward"][:-1].tobytes()
        assert episode.terminations.tolist() == mine["next.done"][:-1].tolist()
        assert episode.truncations[-1] != episode.terminations[-1]


LEROBOT = """
import sys, numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
dataset = LeRobotDataset("ctrl_rl/drives", root=sys.argv[1])
table = dataset.hf_dataset.with_format("arrow")[:]
arrays = {}
for name in table.column_names:
    if name != "observation.image":
        flat = table.column(name).combine_chunks()
        arrays[name] = np.asarray((flat.flatten() if hasattr(flat, "flatten") else flat).to_numpy(zero_copy_only=False))
item = dataset[1]
arrays["picture"] = np.round(255 * item["observation.image"].numpy().transpose(1, 2, 0)).astype(np.uint8)
arrays["lengths"] = np.array(dataset.meta.episodes["length"])
assert item["task"] == "mine" and dataset.fps == 10 and dataset.num_episodes == 3, (item["task"], dataset.fps)
np.savez(sys.argv[2], **arrays)
"""


def test_lerobot_reads_the_same_bits(bag: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    python = next((each for each in (sys.executable, "python-lerobot") if has_lerobot(each)), None)
    if python is None:
        pytest.skip("no lerobot here, nor a program python-lerobot on the path")
    export_bags([bag], tmp_path / "set", "lerobot", ExtractionOptions())
    subprocess.run([python, "-c", LEROBOT, tmp_path / "set", tmp_path / "read.npz"], check=True)
    ours = extracted(bag)
    with np.load(tmp_path / "read.npz") as read:
        assert read["lengths"].tolist() == [1006, 10, 8]
        assert (read["picture"] == ours[0]["observation.image"][1]).all()
        for name in set(ours[0]) - {"observation.image"}:
            mine = np.concatenate([each[name] for each in ours])
            assert read[name].astype(mine.dtype).tobytes() == mine.tobytes(), name


def has_lerobot(python: str) -> bool:
    try:
        return subprocess.run([python, "-c", "import lerobot"], capture_output=True, check=False).returncode == 0
    except OSError:
        return False


def test_a_missing_package_is_named(bag: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setitem(sys.modules, "ctrl_rl_bags.datasets.lerobot_format", None)
    assert main(["export", str(bag), "--format", "lerobot", "--output", str(tmp_path / "set")]) == 1
    assert "needs pyarrow: python -m pip install -r requirements/datasets.txt" in capsys.readouterr().err


@pytest.mark.skipif(not OFFICE.exists(), reason="the recording is not here")
def test_a_real_recording_becomes_a_dataset(tmp_path: Path, capsys) -> None:
    pytest.importorskip("pyarrow")
    assert main(["export", str(OFFICE), "--format", "lerobot", "--output", str(tmp_path / "set")]) == 0
    said = capsys.readouterr()
    assert "no /reward: no rewards" in said.err
    layout, frames = read_dataset(tmp_path / "set")
    assert sum(len(piece) for piece in frames) > 50
    assert not layout.reward


@pytest.mark.fault
@pytest.mark.parametrize("kind", FORMATS)
def test_a_dataset_that_is_damaged_is_one_line(kind: str, bag: Path, tmp_path: Path, capsys) -> None:
    pytest.importorskip(FORMATS[kind])
    folder = tmp_path / "set"
    assert main(["import", str(folder), "--output", str(tmp_path / "bags")]) == 1
    assert "is no dataset" in capsys.readouterr().err
    export_bags([bag], folder, kind, ExtractionOptions())
    info = folder / ("meta/info.json" if kind == "lerobot" else "data/metadata.json")
    data = folder / ("data/chunk-000/file-000.parquet" if kind == "lerobot" else "data/main_data.hdf5")
    whole, told = data.read_bytes(), info.read_text()
    data.write_bytes(whole[: len(whole) // 2])
    assert main(["import", str(folder), "--output", str(tmp_path / "bags")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    data.write_bytes(whole)
    info.write_text(told.replace('"beams": 8', '"beams": 9'))
    assert main(["import", str(folder), "--output", str(tmp_path / "bags")]) == 1
    assert "scan" in capsys.readouterr().err
    assert [each.name for each in tmp_path.iterdir()] == ["set"]


def test_bags_without_drives_are_refused_in_one_line(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "empty") as writer:
        writer.add_topic(MessageMaker().topic("/scan", SCAN_TYPE))
    with pytest.raises(BagError, match=r"no topic /odom \(nav_msgs/msg/Odometry\), /cmd_vel or /rotor_thrusts"):
        export_bags([tmp_path / "empty"], tmp_path / "set", "lerobot", ExtractionOptions())
    assert not (tmp_path / "set").exists()


@pytest.mark.fault
@pytest.mark.parametrize("kind", FORMATS)
def test_a_pipe_in_a_dataset_is_no_wait(kind: str, bag: Path, tmp_path: Path, capsys) -> None:
    pytest.importorskip(FORMATS[kind])
    export_bags([bag], tmp_path / "set", kind, ExtractionOptions())
    data = tmp_path / "set" / ("data/chunk-000/file-000.parquet" if kind == "lerobot" else "data/main_data.hdf5")
    data.unlink()
    os.mkfifo(data)
    assert main(["import", str(tmp_path / "set"), "--output", str(tmp_path / "bags")]) == 1
    assert "is no regular file" in capsys.readouterr().err


@pytest.mark.fault
def test_a_short_parquet_that_unfolds_is_refused(bag: Path, tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.setattr("ctrl_rl_bags.datasets.lerobot_format.MEMORY", 1 << 28)  # a quarter, to unfold less
    pa = pytest.importorskip("pyarrow")
    pq = pytest.importorskip("pyarrow.parquet")
    export_bags([bag], tmp_path / "set", "lerobot", ExtractionOptions())
    data = tmp_path / "set" / "data/chunk-000/file-000.parquet"
    table = pq.read_table(data).slice(0, 225)  # 470 MB, which one array can hold
    giant = pa.array([b"\0" * (1 << 21)] * len(table))
    at = table.column_names.index("observation.image")
    picture = pa.StructArray.from_arrays([giant, pa.nulls(len(table), pa.string())], ["bytes", "path"])
    pq.write_table(table.set_column(at, "observation.image", picture), data, compression="zstd")
    assert data.stat().st_size < 2_000_000
    assert main(["import", str(tmp_path / "set"), "--output", str(tmp_path / "bags")]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.fault
def test_hdf5_does_not_bring_in_other_files(bag: Path, tmp_path: Path, capsys) -> None:
    h5py = pytest.importorskip("h5py")
    export_bags([bag], tmp_path / "set", "minari", ExtractionOptions())
    (tmp_path / "secret").write_bytes(bytes(1 << 20))
    with h5py.File(tmp_path / "set" / "data" / "main_data.hdf5", "r+") as file:
        shape = file["episode_1/observations/scan"].shape
        del file["episode_1/observations/scan"]
        place = [(str(tmp_path / "secret"), 0, h5py.h5f.UNLIMITED)]
        file.create_dataset("episode_1/observations/scan", shape, np.float32, external=place)
    assert main(["import", str(tmp_path / "set"), "--output", str(tmp_path / "bags")]) == 1
    assert "is stored in another file" in capsys.readouterr().err


@pytest.mark.fault
@pytest.mark.parametrize("kind", ["lerobot", "minari"])
@pytest.mark.parametrize("blocks", [1, 8, 24, 32])
def test_a_full_disk_is_one_line_and_leaves_nothing(kind: str, blocks: int, bag: Path, tmp_path: Path) -> None:
    """HDF5 alone would crash the process with a segmentation fault."""
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]) * 1024,) * 2)\n"
        "from ctrl_rl_bags.cli import main; sys.exit(main(sys.argv[2:]))"
    )
    words = ["export", bag, "--format", kind, "--output", tmp_path / "data"]
    answer = subprocess.run(
        # Without -B, a module that has changed would leave a truncated .pyc, on which every later import fails.
        [sys.executable, "-B", "-c", code, str(blocks), *words],
        capture_output=True,
        text=True,
        check=False,
    )
    lines = [line for line in answer.stderr.splitlines() if "cannot be written: File too large" in line]
    assert (answer.returncode, len(lines)) == (1, 1), answer.stderr
    assert "Traceback" not in answer.stderr
    assert list(tmp_path.iterdir()) == []
