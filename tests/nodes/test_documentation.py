# SPDX-License-Identifier: Apache-2.0
"""msg_docs says what the running nodes do."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from sensor_msgs.msg import PointCloud2

from machine_tool_calibration.nodes.ros.messages import LATCHED, columns
from machine_tool_calibration.recording.graph import GRAPH_TOPICS
from machine_tool_calibration.recording.open import open_measurement
from machine_tool_calibration.recording.session_bag import session_to_bag

from .conftest import ORIGIN, PATIENCE
from .forked import ForkedGraph
from .heard import check_content, check_ends, check_services, check_topics, hear
from .pages import FOLDER, PAGES, anchors, message_of, rows, sections

SOURCE = Path(__file__).parents[2] / "src/machine_tool_calibration/nodes"
SESSION = Path(__file__).parents[1] / "data" / "tracking_2d"
NODES = ("recorder", "axis_simulator", "rotary_pointer", "instrument", "procedure", "estimator")
FACTS = ["publisher", "QoS", "rate", "frame", "subscribe"]


@pytest.mark.parametrize("name", rows())
def test_every_topic_has_all_its_parts(name):
    row = rows()[name]
    (section,) = sections()[name]
    assert (section.page, section.type) == (row.page, row.type)
    assert [fact for fact in FACTS if section.facts.get(fact)] == FACTS
    assert section.facts["QoS"] == row.qos
    latched = "transient local" in row.qos
    assert section.facts["subscribe"].startswith("[latched") == latched
    links = re.findall(r"\]\(subscribing\.md(?:#(\w+))?\)", section.facts["subscribe"])
    assert links or name == "/clock"
    kind = row.type.rsplit("/", 1)[1]
    assert all(link in ("", kind.lower()) for link in links)
    assert section.names
    assert section.examples
    for example in section.examples:
        message = message_of(section.type, example)
        if isinstance(message, PointCloud2):
            fields = columns(message)
            assert len(message.data) == message.row_step == message.width * message.point_step
            assert set(fields) == set(section.names)


def test_every_type_is_explained_for_every_language():
    text = PAGES["subscribing"]
    for heading in ("## rclpy", "## rclcpp", "## Websocket"):
        assert f"\n{heading}\n" in text
    explained = re.split(r"(?m)^### ", text)[1:]
    for kind in {row.type.rsplit("/", 1)[1] for row in rows().values()}:
        (part,) = [part for part in explained if kind in part.split("\n", 1)[0].split(", ")]
        assert all(f"```{language}" in part for language in ("python", "cpp", "js")) or "Plain fields" in part


def test_links_lead_somewhere():
    for page, text in PAGES.items():
        for target, anchor in re.findall(r"\]\((\w+)\.md(?:#([\w-]+))?\)", text):
            assert target in PAGES, (page, target)
            assert not anchor or anchor in anchors(target), (page, target, anchor)


def test_the_recorder_subscribes_to_every_topic_that_is_described():
    recorded = {topic.name: topic for topic in GRAPH_TOPICS}
    # of replays, of the recorder itself, and of all once more
    own = {"/clock", "recorder/status", "player/status", "/diagnostics"}
    assert set(recorded) == set(rows()) - own
    for name, topic in recorded.items():
        assert (topic.type, topic.latched) == (rows()[name].type, "transient local" in rows()[name].qos), name
        assert rows()[name].qos.endswith(f"depth {topic.depth}"), name


def test_topics_of_the_probe_and_the_player(bench):
    session_to_bag(open_measurement(SESSION), bench.folder / "bag", start=round(ORIGIN * 1e9))
    nodes = {
        "axis_simulator": {"use_sim_time": True},
        "probe": {"use_sim_time": True},
        "player": {"bag": str(bench.folder / "bag"), "paused": True},
    }
    graph = bench.stack.enter_context(ForkedGraph(nodes, bench.folder / "log", bench.domain))
    operator = bench.operator(graph)
    heard = hear(operator)
    assert operator.wait(lambda: {"instrument/status", "player/status", "truth/table"} <= set(heard), PATIENCE)
    check_topics(operator.node)
    check_services(operator, ("probe", "player"))
    check_ends(operator, ("axis_simulator", "probe"))
    check_content("player/status", heard["player/status"])
    probe = FOLDER.joinpath("probe.md").read_text()
    assert all(f"`{entry.key}`" in probe for entry in heard["instrument/status"].status[0].values)


@pytest.mark.parametrize("name", [*NODES, "probe", "player"])
def test_every_parameter_has_its_row(name):
    declared = set(yaml.safe_load((SOURCE / "parameters.yaml").read_text())[name])
    (page,) = [page for page in PAGES.values() if f"## Parameters of `{name}`\n" in page]
    section = page.split(f"## Parameters of `{name}`\n")[1].split("\n## ")[0]
    lines = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
    assert set(re.findall(r"`(\w+)`", " ".join(lines))) == declared


def test_the_program_on_the_page_hears_a_map_that_was_latched_before(bench):
    operator = bench.operator()
    sender = operator.node.create_publisher(PointCloud2, "error_map", LATCHED)
    sender.publish(message_of("sensor_msgs/msg/PointCloud2", sections()["error_map"][0].examples[0]))
    program = re.findall(r"^```python\n(.*?)^```", PAGES["subscribing"], re.M | re.S)[0]
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ
    )
    try:
        assert process.stdout.readline() == "1 points in frame machine\n"
    finally:
        process.kill()
        process.communicate()
