# SPDX-License-Identifier: Apache-2.0
"""The environment's topics, kept so that each reading gets what was sensed at its own time."""

from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import FluidPressure, RelativeHumidity, Temperature

from machine_tool_calibration.nodes.ros.messages import SLOW, dated, from_message, nanoseconds
from machine_tool_calibration.nodes.ros.node import GuardedNode

TOPICS = {
    **{f"temperature_{place}": (Temperature, "temperature") for place in ("air", "x", "y", "z", "table", "work")},
    "air_pressure": (FluidPressure, "fluid_pressure"),
    "relative_humidity": (RelativeHumidity, "relative_humidity"),
}
"""Message type and field of `environment/<column>`, by the session's column."""

_SAMPLES_KEPT = 100  # of each quantity


class EnvironmentTopics:
    """Publishes what the sensors show, by the session's column: each second, in simulated time each minute of it."""

    def __init__(self, node: GuardedNode, sensed: Callable[[int], Mapping[str, float]]) -> None:
        self._period = nanoseconds(60.0 if node.lives_in_simulated_time else 1.0)
        self._sensed, self._stamp = sensed, 0
        self._publishers = {
            name: node.create_publisher(kind, f"environment/{name}", SLOW) for name, (kind, _) in TOPICS.items()
        }

    def tell(self, stamp: int) -> None:
        """Publish what is sensed at a time, ns, if it was not told of late."""
        if abs(stamp - self._stamp) < self._period:
            return
        self._stamp = stamp
        for name, value in self._sensed(stamp).items():
            kind, field = TOPICS[name]
            self._publishers[name].publish(dated(kind(**{field: value}), stamp))


class EnvironmentWatch:
    """Subscribes to all sensors; a sample farther than `maximum_age`, s, from a reading is not used."""

    def __init__(self, node: Node, maximum_age: float) -> None:
        self._age = nanoseconds(maximum_age)
        self._samples: dict[str, deque[tuple[int, float]]] = {name: deque(maxlen=_SAMPLES_KEPT) for name in TOPICS}
        for name, (kind, field) in TOPICS.items():
            node.create_subscription(kind, f"environment/{name}", partial(self._keep, name, field), SLOW)

    def _keep(self, name: str, field: str, message: Any) -> None:
        self._samples[name].append((from_message(message.header.stamp), float(getattr(message, field))))

    def at(self, stamp: int) -> dict[str, float]:
        """What each sensor showed at a time, ns; sensors that did not speak near it are left out."""
        found = {name: interpolate(samples, stamp, self._age) for name, samples in self._samples.items() if samples}
        return {name: value for name, value in found.items() if value is not None}


def interpolate(samples: deque[tuple[int, float]], stamp: int, age: int) -> float | None:
    """The value at a time, ns, from samples no farther than `age`, ns: interpolated, or else that of the nearest."""
    near = sorted((time - stamp, value) for time, value in samples if abs(time - stamp) <= age)
    return float(np.interp(0.0, [time for time, _ in near], [value for _, value in near])) if near else None
