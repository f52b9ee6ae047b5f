# SPDX-License-Identifier: Apache-2.0
"""Bags are what rosbag2 writes: other readers agree on every message and on all that describes it."""

import errno
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from machine_tool_calibration.errors import RecordingError
from machine_tool_calibration.recording import writer
from machine_tool_calibration.recording.cdr import TEXT, encode
from machine_tool_calibration.recording.reader import BagReader
from machine_tool_calibration.recording.recover import recover
from machine_tool_calibration.recording.writer import BagWriter

JOINT_STATE_HASH = "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"


def by_time(messages: list[tuple[str, int, bytes]]) -> list[tuple[str, int, bytes]]:
    return sorted(messages, key=lambda message: message[1])


def test_three_readers_agree(small_bag: Callable[..., Path]) -> None:
    path = small_bag(messages=200, chunk_bytes=4096)
    own = by_time([(m.topic, m.log_time, m.data) for m in BagReader(path).messages()])
    assert len(own) == 401
    with Reader(path) as reader:
        other = by_time([(c.topic, t, bytes(data)) for c, t, data in reader.messages()])
        assert reader.message_count == 401
        assert reader.ros_distro == "jazzy"
    assert own == other
    with next(path.glob("*.mcap")).open("rb") as stream:
        third = make_reader(stream, validate_crcs=True)
        messages = [(c.topic, m.log_time, m.data) for _, c, m in third.iter_messages(log_time_order=True)]
    assert own == by_time(messages)


def test_header_schemas_channels_and_metadata_record(small_bag: Callable[..., Path]) -> None:
    path = small_bag()
    with next(path.glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream)
        header, summary = reader.get_header(), reader.get_summary()
        metadata = list(reader.iter_metadata())
        assert summary is not None
        published = [(m.publish_time, m.sequence) for _, c, m in reader.iter_messages(topics=["/text"])]
    assert header.profile == "ros2"
    assert header.library.startswith("libmcap 1.")
    schema = next(schema for schema in summary.schemas.values() if schema.name == "sensor_msgs/msg/JointState")
    assert schema.encoding == "ros2msg"
    parts = schema.data.decode().split("=" * 80 + "\n")
    assert parts[0].startswith("std_msgs/Header header\nstring[] name\nfloat64[] position\n")
    assert [part.splitlines()[0] for part in parts[1:]] == ["MSG: std_msgs/Header", "MSG: builtin_interfaces/Time"]
    channel = next(channel for channel in summary.channels.values() if channel.topic == "/cell/joint_states")
    assert channel.message_encoding == "cdr"
    assert channel.metadata["topic_type_hash"] == JOINT_STATE_HASH
    profiles = yaml.safe_load(channel.metadata["offered_qos_profiles"])
    assert [profile["durability"] for profile in profiles] == ["volatile", "transient_local"]
    assert summary.statistics is not None
    assert summary.statistics.message_count == 101
    assert all(index.compression == "zstd" for index in summary.chunk_indexes)
    record = metadata[-1]
    assert record.name == "rosbag2"
    assert yaml.safe_load(record.metadata["serialized_metadata"])["message_count"] == 101
    assert published == [(1_699_999_999_999_999_995, 7)]


def test_metadata_file_has_the_keys_of_version_9(small_bag: Callable[..., Path]) -> None:
    path = small_bag()
    information = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert set(information) == {
        *("version", "storage_identifier", "duration", "starting_time", "message_count", "topics_with_message_count"),
        *("relative_file_paths", "compression_format", "compression_mode", "files", "custom_data", "ros_distro"),
    }
    assert information["version"] == 9
    assert information["storage_identifier"] == "mcap"
    assert information["relative_file_paths"] == ["bag_0.mcap"]
    assert information["starting_time"] == {"nanoseconds_since_epoch": 1_700_000_000_000_000_000}
    assert information["duration"] == {"nanoseconds": 49 * 20_000_000 + 5}
    counts = {t["topic_metadata"]["name"]: t["message_count"] for t in information["topics_with_message_count"]}
    assert counts == {"/text": 1, "/cell/joint_states": 50, "/instrument/displacement": 50, "/empty": 0}
    topic = information["topics_with_message_count"][1]["topic_metadata"]
    assert topic["type_description_hash"] == JOINT_STATE_HASH
    assert topic["serialization_format"] == "cdr"
    assert topic["offered_qos_profiles"][0] == {
        "history": "keep_last",
        "depth": 10,
        "reliability": "reliable",
        "durability": "volatile",
        "deadline": {"sec": 9223372036, "nsec": 854775807},
        "lifespan": {"sec": 9223372036, "nsec": 854775807},
        "liveliness": "automatic",
        "liveliness_lease_duration": {"sec": 9223372036, "nsec": 854775807},
        "avoid_ros_namespace_conventions": False,
    }


def test_every_standard_type_has_a_definition_that_others_parse() -> None:
    from rosbags.typesys import get_types_from_msg

    from machine_tool_calibration.recording.cdr import definition_of
    from machine_tool_calibration.recording.graph import GRAPH_TOPICS

    for kind in {topic.type for topic in GRAPH_TOPICS}:
        definition = definition_of(kind)
        assert definition.type_hash.startswith("RIHS01_")
        assert kind in get_types_from_msg(definition.text, kind)
    assert definition_of("no_msgs/msg/Such").text == ""


@pytest.mark.long
def test_split_by_size_and_by_time(small_bag: Callable[..., Path]) -> None:
    by_size = small_bag("size", messages=3000, chunk_bytes=8192, split_bytes=200_000)
    sizes = [file.stat().st_size for file in by_size.glob("*.mcap")]
    assert len(sizes) > 2
    assert max(sizes) < 230_000
    by_time_ = small_bag("time", messages=500, split_seconds=3.0)
    assert sorted(file.name for file in by_time_.glob("*.mcap")) == [f"time_{i}.mcap" for i in range(4)]
    for path, count in ((by_size, 6001), (by_time_, 1001)):
        assert sum(1 for _ in BagReader(path).messages()) == count
        with Reader(path) as reader:
            assert sum(1 for _ in reader.messages()) == count
        information = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        assert sum(file["message_count"] for file in information["files"]) == count


def test_a_bag_without_messages(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/text", TEXT)
    reader = BagReader(tmp_path / "bag")
    assert reader.messages_in_all == 0
    assert reader.duration == 0.0
    assert list(reader.messages()) == []
    with Reader(tmp_path / "bag") as other:
        assert other.message_count == 0


def test_a_folder_that_is_not_empty_is_left_alone(small_bag: Callable[..., Path]) -> None:
    path = small_bag()
    before = (path / "bag_0.mcap").read_bytes()
    with pytest.raises(RecordingError, match="is not empty"):
        BagWriter(path)
    assert (path / "bag_0.mcap").read_bytes() == before


def test_a_topic_must_be_registered(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag, pytest.raises(RecordingError, match="'/nowhere' was not registered"):
        bag.write("/nowhere", b"", 0)


def test_what_is_older_than_the_period_is_written_at_the_next_tick(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock of the test's own: so long, and no longer, a message waits, be it followed by another or not."""
    now = [1000.0]
    monkeypatch.setattr(writer, "time", SimpleNamespace(monotonic=lambda: now[0]))
    bag = BagWriter(tmp_path / "bag", flush_seconds=0.4)
    bag.add_topic("/text", TEXT)
    bag.write("/text", encode(TEXT, "first"), 1)
    bag.flush()

    def survive() -> int:
        """Messages that a kill would leave now."""
        with tempfile.TemporaryDirectory(dir=tmp_path) as folder:
            return recover(bag.folder, Path(folder, "saved")).messages

    bag.write("/text", encode(TEXT, "second"), 2)
    now[0] += 0.39
    bag.tick()
    assert survive() == 1
    now[0] += 0.02
    bag.tick()
    assert survive() == 2
    for _ in range(3):  # a stream without a pause
        now[0] += 0.15
        bag.write("/text", encode(TEXT, "more"), 3)
    assert survive() == 5
    bag.close()


def full_disk(monkeypatch: pytest.MonkeyPatch, room: list[int]) -> None:
    """A disk that takes so many bytes more, and then half of a write before it fails."""
    write = os.write

    def limited(file: int, data: bytes) -> int:
        taken = min(room[0], len(data))
        if not taken:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        room[0] -= taken
        return write(file, bytes(data[:taken]))

    monkeypatch.setattr(writer.os, "write", limited)


def test_what_a_full_disk_refuses_waits_for_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    room = [6_000]
    full_disk(monkeypatch, room)
    monkeypatch.setattr(writer, "_MOST_WAITING", 5_000)
    bag = BagWriter(tmp_path / "bag", flush_seconds=3600)
    bag.add_topic("/text", TEXT)
    taken, refused = 0, set()
    for i in range(60):
        try:
            bag.write("/text", encode(TEXT, os.urandom(100).hex()), i)
            taken += 1
            bag.flush()
        except RecordingError as error:
            assert "No space left on device" in str(error)
            assert "mtcal recover" in str(error)
            refused.add(i)
    assert 20 < taken < 60 and len(refused) > 60 - taken
    assert bag.messages == taken and bag.waits
    room[0] = 10**9  # somebody made room
    assert 0 < recover(tmp_path / "bag", tmp_path / "new").messages < taken  # as if it had been killed
    bag.write("/text", encode(TEXT, "again"), 100)
    bag.flush()
    assert not bag.waits
    bag.close()
    monkeypatch.undo()
    assert BagReader(tmp_path / "bag").messages_in_all == taken + 1
    with Reader(tmp_path / "bag") as reader:
        assert sum(1 for _ in reader.messages()) == taken + 1


def test_a_disk_that_is_full_between_two_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = BagWriter(tmp_path / "bag", flush_seconds=3600, split_seconds=1.0)
    bag.add_topic("/text", TEXT)
    bag.write("/text", encode(TEXT, "first"), 0)
    bag.flush()
    opened = writer.os.open

    def refused(*arguments: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(writer.os, "open", refused)
    for i in (2, 3):
        with pytest.raises(RecordingError, match="No space left"):
            bag.write("/text", encode(TEXT, "refused"), i * 10**9)
    monkeypatch.setattr(writer.os, "open", opened)
    bag.write("/text", encode(TEXT, "second"), 4 * 10**9)
    bag.close()
    texts = [BagReader(bag.folder).decode(message).data for message in BagReader(bag.folder).messages()]
    assert texts == ["first", "second"]
    with pytest.raises(RecordingError, match="is closed"):
        bag.write("/text", b"", 0)


def test_a_disk_that_stays_full_leaves_what_recover_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = BagWriter(tmp_path / "bag", flush_seconds=3600)
    bag.add_topic("/text", TEXT)
    bag.write("/text", encode(TEXT, "kept"), 1)
    bag.flush()
    full_disk(monkeypatch, [0])
    bag.write("/text", encode(TEXT, "lost"), 2)
    with pytest.raises(RecordingError, match="No space left"):
        bag.close()
    monkeypatch.undo()
    assert bag.messages == 1
    assert recover(tmp_path / "bag", tmp_path / "new").messages == 1
