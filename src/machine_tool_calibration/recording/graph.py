"""The topics that a measurement's graph has, for whoever records or replays it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from machine_tool_calibration.recording.qos import Qos

__all__ = ["GRAPH_TOPICS", "GraphTopic", "belongs_to_graph", "compatible", "request_for"]


@dataclass(frozen=True)
class GraphTopic:
    """A topic of the graph by its relative name; latched ones reach subscribers that come late."""

    name: str
    type: str
    latched: bool = False


_STATUS = "diagnostic_msgs/msg/DiagnosticArray"

GRAPH_TOPICS = (
    GraphTopic("session", "std_msgs/msg/String", latched=True),
    GraphTopic("reading", "sensor_msgs/msg/JointState", latched=True),
    GraphTopic("axes/joint_trajectory", "trajectory_msgs/msg/JointTrajectory"),
    GraphTopic("joint_states", "sensor_msgs/msg/JointState"),
    GraphTopic("axes/status", _STATUS),
    GraphTopic("truth/functional_point", "geometry_msgs/msg/PoseStamped"),
    GraphTopic("truth/table", "geometry_msgs/msg/PoseStamped"),
    GraphTopic("pointer/command", "geometry_msgs/msg/PointStamped"),
    GraphTopic("pointer/state", "sensor_msgs/msg/JointState"),
    GraphTopic("truth/beam", "geometry_msgs/msg/PoseStamped"),
    GraphTopic("instrument/displacement", "std_msgs/msg/Float64MultiArray"),
    GraphTopic("instrument/status", _STATUS, latched=True),
    GraphTopic("probe/trigger", "sensor_msgs/msg/JointState"),
    *(
        GraphTopic(f"environment/temperature_{place}", "sensor_msgs/msg/Temperature")
        for place in ("air", "x", "y", "z", "table", "work")
    ),
    GraphTopic("environment/air_pressure", "sensor_msgs/msg/FluidPressure"),
    GraphTopic("environment/relative_humidity", "sensor_msgs/msg/RelativeHumidity"),
    GraphTopic("procedure/status", _STATUS, latched=True),
    GraphTopic("error_map", "sensor_msgs/msg/PointCloud2", latched=True),
    GraphTopic("error_map/axes", "sensor_msgs/msg/PointCloud2", latched=True),
    GraphTopic("error_map/arrows", "visualization_msgs/msg/MarkerArray", latched=True),
    GraphTopic("error_map/result", "std_msgs/msg/String", latched=True),
    GraphTopic("residuals", "sensor_msgs/msg/PointCloud2", latched=True),
    GraphTopic("comparison/result", "std_msgs/msg/String", latched=True),
    GraphTopic("diagnosis", _STATUS, latched=True),
    GraphTopic("diagnosis/result", "std_msgs/msg/String", latched=True),
    GraphTopic("improvement/result", "std_msgs/msg/String", latched=True),
    GraphTopic("estimator/status", _STATUS, latched=True),
)
"""Subscribed from the start, so that a node that comes later loses nothing."""

_GROUPS = (
    "axes",
    "pointer",
    "truth",
    "instrument",
    "environment",
    "probe",
    "procedure",
    "estimator",
    "error_map",
    "comparison",
    "diagnosis",
    "improvement",
)


def belongs_to_graph(name: str, namespace: str) -> bool:
    """Whether a topic that was discovered is one of a graph's, beyond those of `GRAPH_TOPICS`.

    Args:
        name: absolute name.
        namespace: the graph's.
    """
    prefix = namespace.rstrip("/") + "/"
    return name.startswith(prefix) and name.removeprefix(prefix).split("/")[0] in _GROUPS


def request_for(offered: Iterable[Qos]) -> Qos:
    """What a recorder asks for, so that every publisher matches and latched messages come too."""
    profiles = list(offered)
    reliable = bool(profiles) and all(profile.reliability == "reliable" for profile in profiles)
    latched = bool(profiles) and all(profile.latched for profile in profiles)
    return Qos(
        depth=1000,
        reliability="reliable" if reliable else "best_effort",
        durability="transient_local" if latched else "volatile",
    )


def compatible(request: Qos, offered: Qos) -> bool:
    """Whether a publisher's messages reach a subscriber that asks for this."""
    if request.reliability == "reliable" and offered.reliability != "reliable":
        return False
    return not request.latched or offered.latched
