"""Bags: writing, reading with other libraries, recovery."""

import resource
import shutil
import subprocess
import sys

import numpy as np
import pytest
import yaml
from bag_messages import LATCHED, OFFICE, STORE, cdr, scan, text, topic, write_texts
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from ctrl_rl_bags import BagError, BagWriter, bag_info, read_messages, read_raw, read_serialized, recover


class TestWriter:
    def test_other_readers_find_schema_qos_and_bytes(self, tmp_path):
        kinds = ["std_msgs/msg/String", "sensor_msgs/msg/LaserScan", "test_msgs/msg/Command"]
        command = STORE.types["test_msgs/msg/Command"](0.2, -1.5)
        with BagWriter(tmp_path / "bag") as bag:
            for i, kind in enumerate(kinds):
                bag.add_topic(topic(f"/topic{i}", kind, (LATCHED,) if i == 0 else ()))
            bag.write("/topic0", text("hello"), 5)
            bag.write("/topic1", cdr(scan(7, [1.0, np.inf])), 6, 4, 9)
            bag.write("/topic2", cdr(command), 8)
        with AnyReader([tmp_path / "bag"]) as reader:
            found = {c.topic: reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()}
        assert found["/topic0"].data == "hello"
        np.testing.assert_array_equal(found["/topic1"].ranges, [1.0, np.inf])
        assert (found["/topic2"].v, found["/topic2"].omega) == (0.2, -1.5)
        with Reader(tmp_path / "bag") as reader:
            assert (reader.start_time, reader.end_time - 1, reader.message_count) == (5, 8, 3)
            assert reader.connections[0].ext.offered_qos_profiles[0].durability == QosDurability.TRANSIENT_LOCAL
        with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            assert reader.get_header().profile == "ros2"
            summary = reader.get_summary()
            assert [schema.encoding for schema in summary.schemas.values()] == ["ros2msg"] * 3
            assert yaml.safe_load(summary.channels[1].metadata["offered_qos_profiles"]) == [LATCHED]
            assert summary.channels[1].metadata["topic_type_hash"] == STORE.hash_rihs01("std_msgs/msg/String")
            messages = [message for _, _, message in reader.iter_messages()]
            assert [(m.log_time, m.publish_time, m.sequence) for m in messages] == [(5, 5, 0), (6, 4, 9), (8, 8, 0)]

    def test_metadata(self, tmp_path):
        write_texts(tmp_path / "bag")
        metadata = yaml.safe_load((tmp_path / "bag/metadata.yaml").read_text())["rosbag2_bagfile_information"]
        assert metadata["version"] == 9
        assert metadata["storage_identifier"] == "mcap"
        assert metadata["ros_distro"] == "jazzy"
        assert metadata["message_count"] == 40
        assert metadata["duration"]["nanoseconds"] == 390_000_000
        assert metadata["custom_data"]["digest.task"] == "0123"
        assert metadata["topics_with_message_count"][0]["topic_metadata"]["offered_qos_profiles"] == [LATCHED]
        assert metadata["topics_with_message_count"][0]["topic_metadata"]["type_description_hash"].startswith("RIHS01_")

    @settings(max_examples=30, deadline=None)
    @given(
        st.lists(
            st.tuples(st.sampled_from(["/a", "/b", "/c"]), st.binary(max_size=300), st.integers(0, 2**62)), max_size=60
        ),
        st.integers(1, 5000),
    )
    def test_round_trip_keeps_bytes_and_times(self, tmp_path_factory, messages, chunk_bytes):
        folder = tmp_path_factory.mktemp("bags") / "bag"
        with BagWriter(folder, chunk_bytes=chunk_bytes) as bag:
            for name in ("/a", "/b", "/c"):
                bag.add_topic(topic(name, "std_msgs/msg/String"))
            for name, data, time in messages:
                bag.write(name, data, time)
        found = [(m.topic, m.data, m.log_time) for m in read_raw(folder)]
        assert sorted(found) == sorted(messages)
        assert [time for _, _, time in found] == sorted(time for _, _, time in messages)
        assert bag_info(folder).message_count == len(messages)

    def test_splits_by_size_and_by_time(self, tmp_path):
        write_texts(tmp_path / "size", max_file_bytes=3000, chunk_bytes=100)
        write_texts(tmp_path / "time", max_file_s=0.1)
        assert [file.name for file in sorted((tmp_path / "time").glob("*.mcap"))] == [
            f"time_{i}.mcap" for i in range(4)
        ]
        assert len(list((tmp_path / "size").glob("*.mcap"))) > 1
        for name in ("size", "time"):
            assert [m.log_time for m in read_raw(tmp_path / name)] == [i * 10_000_000 for i in range(40)]
        part = bag_info(tmp_path / "time" / "time_1.mcap")
        assert (part.start, part.end, part.message_count) == (100_000_000, 190_000_000, 10)

    def test_empty_bag(self, tmp_path):
        with BagWriter(tmp_path / "bag") as bag:
            bag.add_topic(topic("/talk", "std_msgs/msg/String"))
        assert bag_info(tmp_path / "bag").topics["/talk"].message_count == 0
        assert list(read_messages(tmp_path / "bag")) == []

    def test_never_overwrites(self, tmp_path):
        write_texts(tmp_path / "bag")
        before = (tmp_path / "bag/metadata.yaml").read_bytes()
        with pytest.raises(BagError, match="exists"):
            BagWriter(tmp_path / "bag")
        assert (tmp_path / "bag/metadata.yaml").read_bytes() == before

    def test_wrong_topics(self, tmp_path):
        with BagWriter(tmp_path / "bag") as bag:
            with pytest.raises(BagError, match="no topic /talk"):
                bag.write("/talk", b"", 0)
            bag.add_topic(topic("/talk", "std_msgs/msg/String"))
            with pytest.raises(BagError, match="twice"):
                bag.add_topic(topic("/talk", "std_msgs/msg/String"))
            with pytest.raises(BagError, match="times must be"):
                bag.write("/talk", b"", -1)

    def test_stops_whole_before_the_disk_is_full(self, tmp_path):
        with BagWriter(tmp_path / "bag", min_free_bytes=2**62) as bag:
            bag.add_topic(topic("/talk", "std_msgs/msg/String"))
            bag.write("/talk", text("hello"), 1)
            with pytest.raises(BagError, match="left on the disk"):
                bag.flush()
        assert [m.data.data for m in read_messages(tmp_path / "bag")] == ["hello"]

    def test_write_error_leaves_a_whole_bag(self, tmp_path):
        """A file size limit simulates a full disk: writes really fail, in the middle of a chunk."""
        code = (
            "import os, sys; from ctrl_rl_bags import *\n"
            "bag = BagWriter(sys.argv[1])\n"
            "bag.add_topic(Topic('/talk', 'std_msgs/msg/String', 'string data\\n'))\n"
            "try:\n"
            "  for i in range(1000): bag.write('/talk', os.urandom(3000), i)\n"
            "except BagError as error: print(error)\n"
            "try: bag.close()\n"
            "except BagError as error: print(error)\n"
        )
        done = subprocess.run(
            [sys.executable, "-c", code, tmp_path / "bag"],
            capture_output=True,
            text=True,
            check=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, 500_000)),
        )
        assert "cannot be written (File too large)" in done.stdout
        assert "Traceback" not in done.stderr
        times = [message.log_time for message in read_raw(tmp_path / "bag")]
        assert times == list(range(len(times)))
        assert len(times) > 100


class TestReader:
    def test_unknown_topic_and_missing_bag(self, tmp_path):
        write_texts(tmp_path / "bag")
        with pytest.raises(BagError, match=r"no topic /scan; it has /talk"):
            list(read_messages(tmp_path / "bag", ["/scan"]))
        with pytest.raises(BagError, match="there is no such bag"):
            bag_info(tmp_path / "nothing")
        with pytest.raises(BagError, match="is no bag"):
            bag_info(tmp_path)

    def test_cut_off_bag_says_how_to_mend_it(self, tmp_path):
        write_texts(tmp_path / "bag")
        (tmp_path / "bag/metadata.yaml").unlink()
        with pytest.raises(BagError, match="bag recover"):
            bag_info(tmp_path / "bag")

    @pytest.mark.fault
    def test_a_ros1_bag_is_refused_with_the_way_out(self, tmp_path):
        store = get_typestore(Stores.ROS1_NOETIC)
        with Ros1Writer(tmp_path / "old.bag") as bag:
            connection = bag.add_connection("/talk", "std_msgs/msg/String", typestore=store)
            message = store.types["std_msgs/msg/String"]("hello")
            bag.write(connection, 1, store.serialize_ros1(message, "std_msgs/msg/String"))
        (tmp_path / "old.mcap").write_bytes((tmp_path / "old.bag").read_bytes())
        for use in (bag_info, lambda bag: list(read_messages(bag)), lambda bag: list(read_serialized(bag))):
            for name in ("old.bag", "old.mcap"):
                with pytest.raises(
                    BagError, match="is a ROS 1 bag: convert it first with rosbags-convert --src"
                ) as told:
                    use(tmp_path / name)
                assert "bag recover" not in str(told.value)

    @pytest.mark.skipif(not OFFICE.exists(), reason="the recording is not here")
    def test_older_sqlite3_bag(self):
        info = bag_info(OFFICE)
        assert info.message_count == 2425
        assert info.topics["/scan"].type == "sensor_msgs/msg/LaserScan"
        assert sum(1 for _ in read_messages(OFFICE, ["/odom"])) == 920


class TestRecover:
    @settings(max_examples=60, deadline=None)
    @given(st.floats(0.0, 1.0), st.sampled_from([200, 100_000]))
    def test_any_cut_gives_a_prefix(self, tmp_path_factory, where, chunk_bytes):
        folder = write_texts(tmp_path_factory.mktemp("bags") / "bag", chunk_bytes=chunk_bytes)
        whole = [(m.data, m.log_time) for m in read_raw(folder)]
        (folder / "metadata.yaml").unlink()
        file = folder / "bag_0.mcap"
        file.write_bytes(file.read_bytes()[: int(where * file.stat().st_size)])
        try:
            found = recover(folder)
        except BagError:  # the cut is before the first message
            assert not folder.with_name("bag_recovered").exists()
            return
        got = [(m.data, m.log_time) for m in read_raw(found.folder)]
        assert got == whole[: len(got)]
        assert len(got) == sum(found.messages.values()) > 0
        info = bag_info(found.folder)
        assert info.topics["/talk"].qos == (LATCHED,)
        assert info.custom_data["digest.task"] == "0123"

    @settings(max_examples=40, deadline=None)
    @given(st.floats(0.0, 1.0, exclude_max=True), st.binary(min_size=1, max_size=50))
    def test_any_damage_is_reported_or_survived(self, tmp_path_factory, where, garbage):
        folder = write_texts(tmp_path_factory.mktemp("bags") / "bag", chunk_bytes=200)
        whole = {m.data for m in read_raw(folder)}
        file = folder / "bag_0.mcap"
        data = bytearray(file.read_bytes())
        start = int(where * len(data))
        data[start : start + len(garbage)] = garbage
        file.write_bytes(data)
        try:
            found = recover(folder)
            got = [m.data for m in read_raw(found.folder or folder)]
        except BagError:  # nothing left, or a damaged message definition
            return
        assert set(got) <= whole
        assert len(got) == sum(found.messages.values())

    def test_chunks_behind_a_damaged_one(self, tmp_path):
        folder = write_texts(tmp_path / "bag", chunk_bytes=200)
        file = folder / "bag_0.mcap"
        with file.open("rb") as stream:
            index = make_reader(stream).get_summary().chunk_indexes[2]
        data = bytearray(file.read_bytes())
        data[index.chunk_start_offset + 60 : index.chunk_start_offset + 70] = b"\xff" * 10
        file.write_bytes(data)
        found = recover(folder, tmp_path / "mended")
        times = [m.log_time for m in read_raw(tmp_path / "mended")]
        assert found.unfinished == ["bag_0.mcap"]
        assert found.dropped_bytes > 0
        assert times[-1] == 39 * 10_000_000
        assert 30 < len(times) < 40

    def test_zeros_at_the_end(self, tmp_path):
        folder = write_texts(tmp_path / "bag")
        file = folder / "bag_0.mcap"
        with file.open("rb") as stream:
            index = make_reader(stream).get_summary().chunk_indexes[-1]
        data = file.read_bytes()[: index.chunk_start_offset + index.chunk_length + index.message_index_length]
        file.write_bytes(data + bytes(4096))
        assert recover(folder).messages == {"/talk": 40}

    def test_split_bag_keeps_order(self, tmp_path):
        folder = write_texts(tmp_path / "bag", count=130, max_file_s=0.1)
        (folder / "metadata.yaml").unlink()
        last = folder / "bag_12.mcap"
        last.write_bytes(last.read_bytes()[:-30])
        found = recover(folder)
        assert found.unfinished == ["bag_12.mcap"]
        assert [m.log_time for m in read_raw(found.folder)] == [i * 10_000_000 for i in range(130)]

    def test_whole_bag_is_left_alone(self, tmp_path):
        folder = write_texts(tmp_path / "bag")
        found = recover(folder)
        assert found.folder is None
        assert found.messages == {"/talk": 40}
        assert not (tmp_path / "bag_recovered").exists()

    def test_refusals(self, tmp_path):
        folder = write_texts(tmp_path / "bag")
        (folder / "metadata.yaml").unlink()
        (tmp_path / "taken").mkdir()
        with pytest.raises(BagError, match="exists"):
            recover(folder, tmp_path / "taken")
        with pytest.raises(BagError, match=r"no \.mcap or \.db3 file"):
            recover(tmp_path / "taken")
        with pytest.raises(BagError, match="no such bag"):
            recover(tmp_path / "nothing")


def test_a_copied_bag_can_be_renamed(tmp_path):
    shutil.copytree(write_texts(tmp_path / "bag"), tmp_path / "copy")
    assert len(list(read_raw(tmp_path / "copy"))) == 40
