# SPDX-License-Identifier: Apache-2.0
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.recording.cdr import JOINT_STATE, NUMBERS, TEXT, encode, encode_joint_state, part
from machine_tool_calibration.recording.metadata import LATCHED, Qos
from machine_tool_calibration.recording.writer import BagWriter

START = 1_700_000_000_000_000_000


def batch(values: np.ndarray) -> bytes:
    dims = [
        part("std_msgs/msg/MultiArrayDimension", "sample", len(values), values.size),
        part("std_msgs/msg/MultiArrayDimension", "time,displacement", 2, 2),
    ]
    return encode(NUMBERS, part("std_msgs/msg/MultiArrayLayout", dims, 0), values.ravel())


@pytest.fixture
def small_bag(tmp_path: Path) -> Callable[..., Path]:
    """Writes a bag with four topics, of which one is empty."""

    def make(name: str = "bag", messages: int = 50, **options: object) -> Path:
        path = tmp_path / name
        rng = np.random.default_rng(5)
        with BagWriter(path, **options) as bag:  # type: ignore[arg-type]
            bag.add_topic("/text", TEXT, qos=[LATCHED])
            bag.add_topic("/cell/joint_states", JOINT_STATE, qos=[Qos(), LATCHED])
            bag.add_topic("/instrument/displacement", NUMBERS, qos=[Qos()])
            bag.add_topic("/empty", "diagnostic_msgs/msg/DiagnosticArray")
            bag.write("/text", encode(TEXT, "héllo"), START, START - 5, 7)
            for i in range(messages):
                at = START + i * 20_000_000
                bag.write(
                    "/cell/joint_states", encode_joint_state(at, "f", ["x", "y"], rng.normal(size=2)), at, at - 9, i
                )
                bag.write("/instrument/displacement", batch(rng.normal(size=(10, 2))), at + 5)
        return path

    return make
