# SPDX-License-Identifier: Apache-2.0
"""The files for RViz and Foxglove name topics of the graph, with displays for their types.

That the running nodes have the topics, types and qualities of msg_docs is seen in test_documentation.
"""

import json
from pathlib import Path

import yaml

from .pages import rows, sections

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


def published(name):
    """Type and quality of service of a topic."""
    row = rows()[name.strip("/")]
    return row.type, row.qos.split(", ")


def test_rviz_shows_topics_of_the_graph():
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
        kind, quality = published(topic["Value"])
        assert kind == takes
        # else the latched map never comes
        assert topic["Durability Policy"] == ("Transient Local" if "transient local" in quality else "Volatile")
        assert "reliable" in quality and topic["Reliability Policy"] == "Reliable"
        assert (topic["History Policy"], topic["Depth"]) == ("Keep Last", 1)
        shown += 1
    assert shown


def test_foxglove_shows_topics_of_the_graph():
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
