# SPDX-License-Identifier: Apache-2.0
"""What was whole is saved, wherever the file was cut or damaged."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import Reader

from machine_tool_calibration.errors import RecordingError, SessionError
from machine_tool_calibration.recording.mcap_reader import McapReader
from machine_tool_calibration.recording.reader import BagReader, Message
from machine_tool_calibration.recording.recover import recover
from machine_tool_calibration.recording.session_bag import session_from_bag


def whole(path: Path) -> list[Message]:
    return list(BagReader(path).messages())


@pytest.mark.long
def test_a_file_cut_anywhere(small_bag: Callable[..., Path], tmp_path: Path) -> None:
    path = small_bag(messages=300, chunk_bytes=4096)
    messages = whole(path)
    file = path / "bag_0.mcap"
    data = file.read_bytes()
    (path / "metadata.yaml").unlink()
    most = 0
    for number, end in enumerate(range(len(data) - 1, 3000, -7151)):
        file.write_bytes(data[:end])
        saved = recover(path, tmp_path / f"new{number}")
        new = whole(tmp_path / f"new{number}")
        assert new == messages[: len(new)]
        assert saved.messages == len(new)
        assert saved.problems == ("bag_0.mcap: the end is missing",) or end > len(data) - 5000
        most = max(most, len(new))
        with Reader(tmp_path / f"new{number}") as reader:
            assert reader.message_count == len(new)
        # at most one chunk is lost
        assert len(new) / len(messages) > (end - 15_000) / len(data)
    assert most == len(messages)


def test_says_how_far_it_is(small_bag: Callable[..., Path], tmp_path: Path) -> None:
    path = small_bag(messages=300, chunk_bytes=4096, split_bytes=20_000)
    shares: list[float] = []
    saved = recover(path, tmp_path / "new", shares.append)
    assert len(saved.files) > 1 and len(shares) > 20
    assert shares == sorted(shares) and shares[0] > 0.0 and shares[-1] == 1.0


def test_qos_hash_and_definition_survive(small_bag: Callable[..., Path], tmp_path: Path) -> None:
    path = small_bag()
    before = BagReader(path).topics
    (path / "metadata.yaml").unlink()
    file = path / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-40])
    recover(file, tmp_path / "new")
    after = BagReader(tmp_path / "new").topics
    for name, topic in after.items():
        assert topic == before[name]


def test_a_damaged_chunk_costs_itself(small_bag: Callable[..., Path], tmp_path: Path) -> None:
    path = small_bag(messages=300, chunk_bytes=4096)
    messages = whole(path)
    file = path / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    places = [i for i in range(len(data)) if data[i : i + 4] == b"zstd"]
    data[places[3] + 200] ^= 0xFF
    file.write_bytes(data)
    saved = recover(path, tmp_path / "new")
    new = whole(tmp_path / "new")
    assert len(saved.problems) == 1
    assert "the chunk at byte" in saved.problems[0]
    assert saved.lost_bytes > 0
    assert 0 < len(messages) - len(new) < 60
    kept = {(message.topic, message.log_time) for message in new}
    assert [message for message in messages if (message.topic, message.log_time) in kept] == new


@pytest.mark.parametrize("length", [30, 9000])
def test_behind_a_damaged_length_the_index_shows_the_next_chunk(
    small_bag: Callable[..., Path], tmp_path: Path, length: int
) -> None:
    path = small_bag(messages=300, chunk_bytes=4096)
    messages, file = whole(path), path / "bag_0.mcap"
    begins = sorted(McapReader(file).summary.chunk_channels)
    data = bytearray(file.read_bytes())
    data[begins[1] : begins[1] + length] = bytes(length)
    data[begins[-2] : begins[-2] + 20] = bytes(20)
    file.write_bytes(data)
    saved, new = recover(path, tmp_path / "new"), whole(tmp_path / "new")
    gone = sum(begin < begins[1] + length for begin in begins[1:]) + 1
    per_chunk = len(messages) / len(begins)
    assert len(saved.problems) == gone and 0.5 * gone < (len(messages) - len(new)) / per_chunk < 1.6 * gone
    kept = {(message.topic, message.log_time) for message in new}
    assert [message for message in messages if (message.topic, message.log_time) in kept] == new
    assert 0 < saved.lost_bytes < 1.5 * gone * max(np.diff(begins))


def test_several_files(small_bag: Callable[..., Path], tmp_path: Path) -> None:
    path = small_bag(messages=1200, split_seconds=2.0)
    assert len(list(path.glob("*.mcap"))) == 12  # bag_10 comes after bag_9
    messages = whole(path)
    (path / "metadata.yaml").unlink()
    last = path / "bag_11.mcap"
    last.write_bytes(last.read_bytes()[:-30])
    assert recover(path, tmp_path / "new").messages == len(messages)
    assert whole(tmp_path / "new") == messages


def test_nothing_to_save(tmp_path: Path) -> None:
    for path, expected in ((tmp_path / "x", "no such file or folder"), (tmp_path, "no .mcap file is in this folder")):
        with pytest.raises(RecordingError) as caught:
            recover(path, tmp_path / "new")
        assert str(caught.value) == f"{path}: {expected}"
    (tmp_path / "a.mcap").write_bytes(b"nothing")
    with pytest.raises(RecordingError, match="no file begins as an MCAP file does"):
        recover(tmp_path / "a.mcap", tmp_path / "new")
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(RecordingError, match="no message could be saved"):
        recover(tmp_path / "a.mcap", tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_an_output_that_is_there_is_left_alone(small_bag: Callable[..., Path], tmp_path: Path) -> None:
    path = small_bag()
    with pytest.raises(RecordingError, match="is not empty"):
        recover(path, path)


TOKENS = [b"", b"\0" * 8, b"\xff" * 8, b"\x05", b"\x06", b"\x02", b"zstd", b"lz4\0", b"\x89MCAP0\r\n"]
edits = st.lists(
    st.tuples(st.integers(0, 1 << 24), st.integers(0, 30), st.one_of(st.sampled_from(TOKENS), st.binary(max_size=9))),
    min_size=1,
    max_size=5,
)


@pytest.mark.long
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(edits)
def test_damaged_bytes_give_session_errors_only(
    small_bag: Callable[..., Path], tmp_path: Path, edits: list[tuple[int, int, bytes]]
) -> None:
    source = tmp_path / "good"
    if not source.exists():
        small_bag("good", messages=20, chunk_bytes=2048)
    data = (source / "good_0.mcap").read_bytes()
    for at, length, new in edits:
        at %= len(data)
        data = data[:at] + new + data[at + length :]
    file = tmp_path / "bad.mcap"
    file.write_bytes(data)
    free = tmp_path / f"out{len(list(tmp_path.iterdir()))}"
    for attempt in (lambda: whole(file), lambda: session_from_bag(file), lambda: recover(file, free)):
        try:
            attempt()
        except SessionError as error:
            assert "\n" not in str(error)
