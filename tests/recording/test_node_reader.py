# SPDX-License-Identifier: Apache-2.0
"""Foxglove's readers (npm: @mcap/core and what decodes ROS 2 messages) agree with ours message by message.

They run where node and the packages are found: in build/mcap_readers, or where MTCAL_NODE_MODULES says.
"""

import hashlib
import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from machine_tool_calibration.recording.reader import BagReader
from machine_tool_calibration.recording.session_bag import session_to_bag
from machine_tool_calibration.session.folder import read_session

ROOT = Path(__file__).parents[2]
DATA = Path(__file__).parents[1] / "data"
SCRIPT = Path(__file__).parent / "node" / "read_mcap.cjs"
MODULES = Path(os.environ.get("MTCAL_NODE_MODULES", ROOT / "build" / "mcap_readers" / "node_modules"))
PACKAGES = ("@mcap/core", "fzstd", "@foxglove/rosmsg", "@foxglove/rosmsg2-serialization")
VERSIONS = ("2", "0.1", "5", "3")
INSTALL = "npm install --no-save --prefix build/mcap_readers " + " ".join(
    f"{name}@{version}" for name, version in zip(PACKAGES, VERSIONS, strict=True)
)


@pytest.fixture
def node() -> str:
    program = shutil.which("node")
    if program is None:
        pytest.skip("node is not installed")
    missing = [name for name in PACKAGES if not (MODULES / name / "package.json").exists()]
    if missing:
        pytest.skip(f"the npm package {missing[0]} is not in {MODULES}; {INSTALL}")
    return program


def by_node(program: str, bag: Path) -> list[dict[str, Any]]:
    out: list[dict[str, Any]] = []
    for file in sorted(bag.glob("*.mcap"), key=lambda path: int(path.stem.rsplit("_", 1)[1])):
        done = subprocess.run(
            [program, str(SCRIPT), str(MODULES), str(file)], capture_output=True, text=True, timeout=900, check=False
        )
        assert done.returncode == 0, done.stderr
        out += [json.loads(line) for line in done.stdout.splitlines()]
    return out


def assert_readers_agree(program: str, bag: Path) -> list[dict[str, Any]]:
    """The four readers have the same messages, and those that decode the same values; what node says of them."""
    theirs = by_node(program, bag)
    own = sorted(
        (m.topic, m.log_time, m.publish_time, hashlib.sha256(m.data).hexdigest()) for m in BagReader(bag).messages()
    )
    assert own == sorted((m["topic"], int(m["log_time"]), int(m["publish_time"]), m["sha256"]) for m in theirs)
    store = get_typestore(Stores.ROS2_JAZZY)
    values = {(m["topic"], int(m["log_time"]), m["sha256"]): m["value"] for m in theirs}
    with Reader(bag) as reader:
        count = 0
        for connection, time, data in reader.messages():
            value = store.deserialize_cdr(data, connection.msgtype)
            assert_same(value, values[connection.topic, time, hashlib.sha256(data).hexdigest()])
            count += 1
    assert count == len(own)
    count = 0
    for file in bag.glob("*.mcap"):
        with file.open("rb") as stream:
            decoded = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
            for _, channel, message, value in decoded:
                expected = values[channel.topic, message.log_time, hashlib.sha256(message.data).hexdigest()]
                assert_same(value, expected)
                count += 1
    assert count == len(own)
    return theirs


def assert_same(value: Any, expected: Any) -> None:
    """A decoded message, whatever its class, against node's plain one; JSON has null for NaN."""
    if isinstance(expected, dict):
        for name, entry in expected.items():
            # builtin_interfaces/Time has another field name in JavaScript
            assert_same(getattr(value, {"nsec": "nanosec"}.get(name, name)), entry)
    elif isinstance(expected, list):
        assert len(value) == len(expected)
        for one, other in zip(value, expected, strict=True):
            assert_same(one, other)
    elif expected is None:
        assert np.isnan(value)
    else:
        assert value == expected


def test_a_bag_of_every_kind_of_message(node: str, small_bag: Callable[..., Path]) -> None:
    theirs = assert_readers_agree(node, small_bag(messages=200, chunk_bytes=4096))
    assert len(theirs) == 401
    (text,) = (m for m in theirs if m["topic"] == "/text")
    assert text["value"] == {"data": "héllo"} and text["sequence"] == 7


def test_a_bag_of_several_files(node: str, small_bag: Callable[..., Path]) -> None:
    bag = small_bag(messages=400, chunk_bytes=4096, split_bytes=20_000)
    assert len(list(bag.glob("*.mcap"))) > 1
    assert len(assert_readers_agree(node, bag)) == 801


@pytest.mark.parametrize("name", ["tracking_2d", "rotary_axis", "step_diagonal", "probing_cross"])
def test_the_recording_of_a_session(node: str, name: str, tmp_path: Path) -> None:
    session = read_session(DATA / name)
    session_to_bag(session, tmp_path / "bag", start=1_700_000_000_000_000_000)
    theirs = assert_readers_agree(node, tmp_path / "bag")
    readings = [m["value"] for m in theirs if m["topic"] == "/reading"]
    place = readings[0]["name"].index("displacement")
    assert [value["position"][place] for value in readings] == session.readings.displacement.tolist()
