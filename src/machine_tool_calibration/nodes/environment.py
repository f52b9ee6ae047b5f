# SPDX-License-Identifier: Apache-2.0
"""The environment's topics, kept so that each reading gets what was sensed at its own time."""

from __future__ import annotations

from collections import deque

from rclpy.node import Node
from sensor_msgs.msg import FluidPressure, RelativeHumidity, Temperature

from machine_tool_calibration.nodes.ros.messages import SLOW, from_message, nanoseconds

__all__ = ["TOPICS", "EnvironmentWatch", "interpolate"]

TOPICS = {
    **{f"temperature_{place}": (Temperature, "temperature") for place in ("air", "x", "y", "z", "table", "work")},
    "air_pressure": (FluidPressure, "fluid_pressure"),
    "relative_humidity": (RelativeHumidity, "relative_humidity"),
}
"""Message type and field of `environment/<column>`, by the session's column."""

_KEPT = 100


class EnvironmentWatch:
    """Subscribes to all sensors.

    Args:
        node: that subscribes.
        maximum_age: a sample farther than this from the reading is not used, s.
    """

    def __init__(self, node: Node, maximum_age: float) -> None:
        self._age = nanoseconds(maximum_age)
        self._samples: dict[str, deque[tuple[int, float]]] = {name: deque(maxlen=_KEPT) for name in TOPICS}
        for name, (kind, field) in TOPICS.items():
            node.create_subscription(kind, f"environment/{name}", self._keeper(name, field), SLOW)

    def _keeper(self, name: str, field: str):  # type: ignore[no-untyped-def]
        samples = self._samples[name]

        def keep(message) -> None:  # type: ignore[no-untyped-def]
            samples.append((from_message(message.header.stamp), float(getattr(message, field))))

        return keep

    def at(self, stamp: int) -> dict[str, float]:
        """What each sensor showed at a time, ns; sensors that did not speak near it are left out."""
        found = {name: interpolate(samples, stamp, self._age) for name, samples in self._samples.items() if samples}
        return {name: value for name, value in found.items() if value is not None}


def interpolate(samples: deque[tuple[int, float]], stamp: int, age: int) -> float | None:
    """The value at a time from samples (time, value) near it: between two samples, or the nearest one.

    Args:
        samples: in any order.
        stamp: the time, ns.
        age: greatest distance of a sample, ns.
    """
    near = sorted(sample for sample in samples if abs(sample[0] - stamp) <= age)
    before = [sample for sample in near if sample[0] <= stamp]
    after = [sample for sample in near if sample[0] > stamp]
    if before and after:
        (t0, v0), (t1, v1) = before[-1], after[0]
        return v0 + (v1 - v0) * (stamp - t0) / (t1 - t0)
    if before:
        return before[-1][1]
    return after[0][1] if after else None
