"""Qualities of service of the graph's topics, as msg_docs states them."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

__all__ = ["COMMAND", "LATCHED", "READINGS", "SLOW", "STATE"]


def _reliable(depth: int, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
    )


COMMAND = _reliable(10)
STATE = _reliable(100)
SLOW = _reliable(10)
LATCHED = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)
# kept for those who come late: an estimator or recorder that (re)starts in the middle gets every reading
READINGS = _reliable(20000, DurabilityPolicy.TRANSIENT_LOCAL)
