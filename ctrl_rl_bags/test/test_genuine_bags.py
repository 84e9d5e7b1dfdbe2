"""Bags from the recorders of all ROS 2 distributions: files take precedence over metadata; differences are reported."""

import json
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
import yaml
import zstandard
from bag_messages import STORE, text
from ctrl_rl_bags.cli import main
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin, Writer

from ctrl_rl_bags import BagError, bag_info, read_messages, recover

COUNT = 60
KIND = "std_msgs/msg/String"
STORAGES = {"mcap": StoragePlugin.MCAP, "db3": StoragePlugin.SQLITE3}


def write(folder: Path, storage: str, first: int = 0, count: int = COUNT, empty: bool = False) -> Path:
    """Write a bag in rosbag2's format and return its only file."""
    with Writer(folder, version=8, storage_plugin=STORAGES[storage]) as bag:
        talk = bag.add_connection("/talk", KIND, typestore=STORE)
        if empty:
            bag.add_connection("/quiet", KIND, typestore=STORE)
        for k in range(first, first + count):
            bag.write(talk, 10**9 + k * 10**8, text(str(k)))
    return next(folder.glob(f"*.{storage}"))


def edit(folder: Path, **changes: object) -> None:
    path = folder / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    content["rosbag2_bagfile_information"].update(changes)
    path.write_text(yaml.safe_dump(content))


def said(folder: Path) -> list[str]:
    return [message.data.data for message in read_messages(folder)]


def compress(folder: Path, file: Path, name: str, listed: str) -> None:
    data = zstandard.ZstdCompressor().compress(file.read_bytes())
    file.unlink()
    (folder / name).write_bytes(data)
    edit(folder, relative_file_paths=[listed], compression_format="zstd", compression_mode="FILE")


@pytest.mark.parametrize("storage", STORAGES)
def test_what_recorders_say_otherwise_is_read_by_the_files(storage: str, tmp_path: Path) -> None:
    def make(name: str, **more: bool) -> tuple[Path, Path]:
        return tmp_path / name, write(tmp_path / name, storage, **more)

    folder, _ = make("humble_split")  # start and duration of the last split
    edit(folder, starting_time={"nanoseconds_since_epoch": 5 * 10**9}, duration={"nanoseconds": 10**9})
    folder, _ = make("reindexed")
    edit(folder, storage_identifier="")
    folder, _ = make("reindexed_empty", empty=True)
    topics = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    edit(folder, topics_with_message_count=[t for t in topics["topics_with_message_count"] if t["message_count"]])
    folder, file = make("zstd_by_plain_name")
    compress(folder, file, f"{file.name}.zstd", file.name)
    folder, file = make("zstd_without_suffix")
    compress(folder, file, file.name, file.name)
    folder, file = make("uncompressed_by_hand")
    edit(folder, relative_file_paths=[f"{file.name}.zstd"], compression_format="zstd", compression_mode="FILE")
    for folder in tmp_path.iterdir():
        assert said(folder) == [str(k) for k in range(COUNT)], folder.name
        assert bag_info(folder).notes or folder.name == "zstd_without_suffix", folder.name


@pytest.mark.parametrize("storage", STORAGES)
def test_a_folder_of_splits_without_metadata_is_recovered(storage: str, tmp_path: Path) -> None:
    folder = tmp_path / "killed"
    folder.mkdir()
    for part in range(3):
        file = write(tmp_path / f"part{part}", storage, 20 * part, 20)
        shutil.copy(file, folder / f"killed_{part}.{storage}")
    with pytest.raises(BagError, match=r"was cut off, it has no metadata\.yaml; recover it with"):
        bag_info(folder)
    recover(folder, tmp_path / "out")
    assert said(tmp_path / "out") == [str(k) for k in range(COUNT)]


def test_messages_in_a_write_ahead_log_are_read(tmp_path: Path) -> None:
    file = write(tmp_path / "bag", "db3")
    log = sqlite3.connect(file)
    log.executescript("pragma journal_mode=wal; pragma wal_autocheckpoint=0")
    log.execute("insert into messages(topic_id, timestamp, data) select topic_id, timestamp + 10000000000, data"
                " from messages")  # fmt: skip
    log.commit()
    killed = tmp_path / "killed"
    shutil.copytree(file.parent, killed)
    log.close()
    (killed / "metadata.yaml").unlink()
    info = bag_info(killed / file.name)
    assert info.message_count == 2 * COUNT
    assert "-wal holds the last messages" in info.notes[0]
    assert recover(killed, tmp_path / "out").messages == {"/talk": 2 * COUNT}


@pytest.mark.parametrize("encoding", ["json", "protobuf", "ros1", "wrong_format", ""])
def test_what_is_not_of_ros_2_is_not_recovered_as_if_it_were(encoding: str, tmp_path: Path, capsys) -> None:
    file = tmp_path / "fox.mcap"
    with file.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="", library="foxglove-sdk")
        schema = writer.register_schema("foxglove.Pose", "jsonschema", b"{}")
        channel = writer.register_channel("/pose", encoding, schema)
        for k in range(5):
            writer.add_message(channel, k, json.dumps({"k": k}).encode(), k)
        writer.finish()
    assert main(["info", str(file)]) == 1
    assert "it is not of ROS 2" in capsys.readouterr().err
    assert main(["recover", str(file), "-o", str(tmp_path / "out")]) == 1
    assert f"holds no ROS 2 messages: they are encoded as {encoding or 'nothing'}" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("what", ["info", "recover", "play", "import"])
def test_a_git_lfs_pointer_is_told(what: str, tmp_path: Path, capsys) -> None:
    file = tmp_path / "drive.mcap"
    file.write_text(f"version https://git-lfs.github.com/spec/v1\noid sha256:{'b9' * 32}\nsize 990\n")
    if what == "import":
        (tmp_path / "set" / "meta").mkdir(parents=True)
        file = file.rename(tmp_path / "set" / "meta" / "info.json").parents[1]
    more = ["-o", str(tmp_path / "out")] if what in ("recover", "import") else []
    assert main([what, str(file), *more]) == 1
    error = capsys.readouterr().err
    assert "is a Git LFS pointer in place of the file: run git lfs pull" in error
    assert len(error.splitlines()) == 1
    assert "recover it" not in error
    assert np.all([path.name in ("drive.mcap", "set") for path in tmp_path.iterdir()])
