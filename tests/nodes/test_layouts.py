"""The files for RViz and Foxglove name topics of the running graph, with displays for their types."""

import json
from pathlib import Path

import pytest
import yaml
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

from .conftest import PATIENCE
from .pages import sections

CONFIG = Path(__file__).parents[2] / "config"

# What the programs' own sources say that each display or panel takes; "": no topic.
RVIZ = {
    "rviz_default_plugins/Grid": "",
    "rviz_default_plugins/MarkerArray": "visualization_msgs/msg/MarkerArray",
    "rviz_default_plugins/Pose": "geometry_msgs/msg/PoseStamped",
}
RVIZ_PARTS = {
    "rviz_common/Displays",
    "rviz_common/Views",
    "rviz_default_plugins/MoveCamera",
    "rviz_default_plugins/Orbit",
    "rviz_default_plugins/Select",
}
STATUS = "diagnostic_msgs/msg/DiagnosticArray"
FOXGLOVE = {"DiagnosticStatusPanel": STATUS, "DiagnosticSummary": STATUS, "RawMessages": None}
SCENE = {"sensor_msgs/msg/PointCloud2", "visualization_msgs/msg/MarkerArray", "geometry_msgs/msg/PoseStamped"}


@pytest.fixture
def published(bench):
    """Type and profile of a topic that a running graph publishes."""
    nodes = ("axis_simulator", "rotary_pointer", "instrument", "procedure", "estimator")
    operator = bench.operator(bench.graph(nodes))

    def look(name):
        name = f"/{name.strip('/')}"
        node = operator._node
        assert operator.wait(lambda: node.count_publishers(name) > 0, PATIENCE), name
        info = node.get_publishers_info_by_topic(name)[0]
        return info.topic_type, info.qos_profile

    return look


def test_layouts_show_topics_of_the_running_graph(published):
    check_rviz(published)
    check_foxglove(published)


def check_rviz(published):
    manager = yaml.safe_load((CONFIG / "rviz" / "error_map.rviz").read_text())
    parts = [panel["Class"] for panel in manager["Panels"]]
    manager = manager["Visualization Manager"]
    parts += [tool["Class"] for tool in manager["Tools"]] + [manager["Views"]["Current"]["Class"]]
    assert set(parts) <= RVIZ_PARTS
    assert manager["Global Options"]["Fixed Frame"] == "machine"
    shown = 0
    for display in manager["Displays"]:
        takes = RVIZ[display["Class"]]
        if not takes:
            continue
        topic = display["Topic"]
        kind, profile = published(topic["Value"])
        assert kind == takes
        # else the latched map never comes
        latched = profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        assert topic["Durability Policy"] == ("Transient Local" if latched else "Volatile")
        assert profile.reliability == ReliabilityPolicy.RELIABLE and topic["Reliability Policy"] == "Reliable"
        assert (topic["History Policy"], topic["Depth"]) == ("Keep Last", 1)
        shown += 1
    assert shown


def check_foxglove(published):
    layout = json.loads((CONFIG / "foxglove" / "calibration.json").read_text())
    assert {"configById", "globalVariables", "userNodes", "layout"} == set(layout)
    panels = layout["configById"]
    for name, panel in panels.items():
        kind = name.split("!")[0]
        if kind == "3D":
            for topic, settings in panel["topics"].items():
                found, _ = published(topic)
                assert found in SCENE
                if "colorField" in settings:
                    (section,) = sections()[topic[1:]]
                    assert settings["colorField"] in section.names
            assert panel["followTf"] == "machine"
        elif kind == "Plot":
            for path in panel["paths"]:
                topic, field = path["value"].split(".", 1)
                assert published(topic)[0] == "sensor_msgs/msg/JointState" and field.startswith("position[")
        else:
            takes = FOXGLOVE[kind]
            found, _ = published(panel["topicPath" if kind == "RawMessages" else "topicToRender"])
            assert takes is None or found == takes

    def leaves(node):
        return [node] if isinstance(node, str) else [*leaves(node["first"]), *leaves(node["second"])]

    assert sorted(leaves(layout["layout"])) == sorted(panels)
