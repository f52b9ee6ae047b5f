# SPDX-License-Identifier: Apache-2.0
"""Bags of others, and bags that are damaged, unfinished or hostile."""

import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.writer import MCAP0_MAGIC as MAGIC
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from machine_tool_calibration.errors import RecordingError, UnfinishedError
from machine_tool_calibration.recording.cdr import TEXT, decode, definition_of, encode, typestore
from machine_tool_calibration.recording.reader import BagReader, is_readable


def foreign(path: Path, profile: str = "ros2", **options: object) -> Path:
    """A file by the mcap library's own writer."""
    with path.open("wb") as stream:
        writer = Writer(stream, **options)  # type: ignore[arg-type]
        writer.start(profile)
        schema = writer.register_schema(TEXT, "ros2msg", definition_of(TEXT).text.encode())
        channel = writer.register_channel("/text", "cdr", schema, {})
        for i in range(20):
            writer.add_message(channel, i * 10, encode(TEXT, f"message {i}"), i * 10, i)
        writer.finish()
    return path


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE},
        {"use_chunking": False},
        {"chunk_size": 64},
        {"index_types": IndexType.NONE},
        {"use_statistics": False},
        {"repeat_channels": False, "repeat_schemas": False},
        {
            "use_statistics": False,
            "repeat_channels": False,
            "index_types": IndexType.NONE,
            "use_summary_offsets": False,
        },
        {"enable_crcs": False, "profile": ""},
    ],
)
def test_any_form_of_mcap(tmp_path: Path, options: dict[str, object]) -> None:
    reader = BagReader(foreign(tmp_path / "a.mcap", **options))  # type: ignore[arg-type]
    assert reader.messages_in_all == 20
    assert (reader.first, reader.last) == (0, 190)
    texts = [reader.decode(message).data for message in reader.messages(["/text"])]
    assert texts == [f"message {i}" for i in range(20)]
    assert list(reader.messages(["/other"])) == []


def test_a_bag_by_rosbags(tmp_path: Path) -> None:
    with RosbagsWriter(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/text", TEXT, typestore=typestore())
        writer.write(connection, 42, encode(TEXT, "there"))
    (message,) = BagReader(tmp_path / "bag").messages()
    assert (message.topic, message.log_time, decode(message.type, message.data).data) == ("/text", 42, "there")


def fails(path: Path, expected: str, kind: type[Exception] = RecordingError) -> None:
    with pytest.raises(kind) as caught:
        list(BagReader(path).messages())
    assert str(caught.value) == expected


def test_no_file_and_no_bag(tmp_path: Path) -> None:
    fails(tmp_path / "x", f"{tmp_path}/x: no such file or folder")
    fails(tmp_path, f"{tmp_path}: is no recording: neither metadata.yaml nor an .mcap file is in it")
    (tmp_path / "a.mcap").write_bytes(b"PK\3\4" * 100)
    fails(tmp_path / "a.mcap", f"{tmp_path}/a.mcap: is not an MCAP file")


def test_another_profile(tmp_path: Path) -> None:
    path = foreign(tmp_path / "a.mcap", profile="ros1")
    fails(path, f"{path}: holds messages of 'ros1', not of ros2")


def test_unfinished(small_bag: Callable[..., Path]) -> None:
    path = small_bag()
    file = path / "bag_0.mcap"
    (path / "metadata.yaml").unlink()
    fails(
        path,
        f"{path}: was not finished (no metadata.yaml; the recorder was killed?); `mtcal recover {path}` makes it whole",
        UnfinishedError,
    )
    data = file.read_bytes()
    file.write_bytes(data[:-1])
    fails(file, f"{file}: was not finished (the recorder was killed?); `mtcal recover` makes it whole", UnfinishedError)
    file.write_bytes(b"")
    fails(file, f"{file}: the file is empty; the recorder was killed before its first second was over", UnfinishedError)


def test_a_wrong_checksum(small_bag: Callable[..., Path]) -> None:
    path = small_bag()
    file = path / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    start = data.index(b"zstd") + 4 + 8
    data[start + 60] ^= 1
    file.write_bytes(data)
    with pytest.raises(RecordingError, match=r"the chunk at byte \d+ (is damaged|cannot be unpacked).*mtcal recover"):
        list(BagReader(path).messages())


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("bag_0.mcap", "../bag/bag_0.mcap", ""),
        ("bag_0.mcap", "../secret.mcap", "the file '../secret.mcap' is outside the bag's folder"),
        ("bag_0.mcap", "/etc/passwd", "the file '/etc/passwd' is outside the bag's folder"),
        ("bag_0.mcap", "gone.mcap", "the file 'gone.mcap' is not there"),
        (
            "storage_identifier: mcap",
            "storage_identifier: sqlite3",
            "the storage is 'sqlite3', not mcap; `ros2 bag convert` can change it",
        ),
        (
            "compression_mode: ''",
            "compression_mode: file",
            "compressed by rosbag2 ('file'); `ros2 bag convert` can unpack it",
        ),
        ("rosbag2_bagfile_information:", "other:", "no rosbag2_bagfile_information; this is not a recording"),
        (
            "  relative_file_paths:\n  - bag_0.mcap",
            "  relative_file_paths: []",
            "relative_file_paths must be a list of files",
        ),
    ],
)
def test_metadata(small_bag: Callable[..., Path], old: str, new: str, expected: str) -> None:
    path = small_bag()
    (path.parent / "secret.mcap").write_bytes((path / "bag_0.mcap").read_bytes())
    metadata = path / "metadata.yaml"
    text = metadata.read_text()
    assert old in text
    metadata.write_text(text.replace(old, new))
    if expected:
        fails(path, f"{metadata}: {expected}")
    else:
        assert BagReader(path).messages_in_all == 101


def test_a_link_out_of_the_folder(small_bag: Callable[..., Path]) -> None:
    path = small_bag()
    file = path / "bag_0.mcap"
    other = path.parent / "secret.mcap"
    file.rename(other)
    file.symlink_to(other)
    fails(path, f"{path}/metadata.yaml: the file 'bag_0.mcap' is outside the bag's folder")


def bomb(path: Path, size: int, claimed: int, copies: int = 1) -> Path:
    """A file whose chunks unpack to far more than their size."""
    foreign(path)
    data = path.read_bytes()
    builder = RecordBuilder()
    packed = zstandard.compress(b"\0" * size)
    for _ in range(copies):
        Chunk(
            compression="zstd",
            data=packed,
            message_end_time=0,
            message_start_time=0,
            uncompressed_crc=0,
            uncompressed_size=claimed,
        ).write(builder)
    header = 8 + 9 + struct.unpack_from("<Q", data, 9)[0]
    path.write_bytes(data[:header] + bytes(builder.end()) + data[-37:-28] + bytes(20) + MAGIC)
    return path


@pytest.mark.long
@pytest.mark.parametrize(
    ("size", "claimed", "copies", "expected"),
    [
        (1 << 30, 1 << 30, 1, "unpacks to 1073741824 bytes; at most 256 MiB are accepted"),
        (1 << 30, 1000, 1, "does not unpack to the 1000 bytes that it declares"),
        (1000, 1 << 20, 1, "does not unpack to the 1048576 bytes that it declares"),
        (1 << 24, 1 << 24, 1, "is damaged"),
    ],
)
def test_bombs(tmp_path: Path, size: int, claimed: int, copies: int, expected: str) -> None:
    path = bomb(tmp_path / "bomb.mcap", size, claimed, copies)
    tracemalloc.start()
    with pytest.raises(RecordingError, match="the chunk at byte") as caught:
        list(BagReader(path).messages())
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert expected in str(caught.value)
    assert peak < 100e6


def test_a_record_that_claims_more_than_there_is(tmp_path: Path) -> None:
    path = foreign(tmp_path / "a.mcap", use_chunking=False)
    data = bytearray(path.read_bytes())
    at = data.index(b"message 3") - 31 - 8
    struct.pack_into("<BQ", data, at, Opcode.MESSAGE, 1 << 60)
    path.write_bytes(data)
    with pytest.raises(UnfinishedError, match="is cut short"):
        list(BagReader(path).messages())


def test_a_type_of_another_package_is_told_but_not_decoded(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("own_msgs/msg/Thing", "ros2msg", b"int32 x\n")
        channel = writer.register_channel("/thing", "cdr", schema, {})
        writer.add_message(channel, 1, b"\0\1\0\0\5\0\0\0", 1)
        writer.finish()
    reader = BagReader(path)
    assert not is_readable(reader.topics["/thing"])
    (message,) = reader.messages()
    with pytest.raises(RecordingError, match=r"/thing has the type 'own_msgs/msg/Thing', which cannot be read"):
        reader.decode(message)


def test_a_standard_type_of_another_form_is_not_decoded(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema(TEXT, "ros2msg", b"int32 data\n")
        writer.register_channel("/text", "cdr", schema, {"topic_type_hash": "RIHS01_" + "0" * 64})
        writer.finish()
    assert not is_readable(BagReader(path).topics["/text"])
