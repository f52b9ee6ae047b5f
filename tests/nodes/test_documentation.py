"""msg_docs says what the running nodes do."""

import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

from machine_tool_calibration.nodes.clouds import columns
from machine_tool_calibration.nodes.graph import Graph, Program
from machine_tool_calibration.nodes.qos import LATCHED
from machine_tool_calibration.recording.graph import GRAPH_TOPICS
from machine_tool_calibration.recording.session_to_bag import session_to_bag
from machine_tool_calibration.session.open import open_measurement

from .conftest import ORIGIN, PATIENCE, SITE, collected
from .pages import FOLDER, PAGES, anchors, message_of, rows, sections

SOURCE = Path(__file__).parents[2] / "src/machine_tool_calibration/nodes"
SESSION = Path(__file__).parents[1] / "data" / "tracking_2d"
NODES = ("recorder", "axis_simulator", "rotary_pointer", "instrument", "procedure", "estimator")
IGNORED = {"/rosout", "/parameter_events"}
ELSEWHERE = {"probe/trigger", "player/status"}
FACTS = ["publisher", "QoS", "rate", "frame", "subscribe"]
NOISY = {**SITE, "noise": 3e-7, "effects": [{"id": "backlash_y", "size": 2e-6}]}


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
    own = {"/clock", "recorder/status", "player/status"}  # of replays, and of the recorder itself
    assert set(recorded) == set(rows()) - own
    for name, topic in recorded.items():
        assert (topic.type, topic.latched) == (rows()[name].type, "transient local" in rows()[name].qos), name
        assert rows()[name].qos.endswith(f"depth {topic.depth}"), name


def shown(profile):
    words = ["reliable" if profile.reliability == ReliabilityPolicy.RELIABLE else "best effort"]
    if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        words.append("transient local")
    return ", ".join(words)


def check_topics(node):
    """Whether the topics that there are have the type and the QoS of the table."""
    table = rows()
    for name, types in node.get_topic_names_and_types():
        if name in IGNORED:
            continue
        key = name if name in table else name[1:]
        assert key in table, f"{name} is not in msg_docs/README.md"
        assert types == [table[key].type], name
        for publisher in node.get_publishers_info_by_topic(name):
            assert re.sub(r", depth \d+", "", table[key].qos) == shown(publisher.qos_profile), name
            if publisher.qos_profile.history == HistoryPolicy.KEEP_LAST:  # discovery does not always tell
                assert table[key].qos.endswith(f"depth {publisher.qos_profile.depth}"), name


def hear(operator):
    """Subscribe to every topic; gives the newest message of each, by name."""
    heard = {}
    for name, row in rows().items():
        package, _, kind = row.type.split("/")
        latched = "transient local" in row.qos
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        operator._node.create_subscription(
            getattr(import_module(f"{package}.msg"), kind),
            name,
            lambda message, name=name: heard.__setitem__(name, message),
            QoSProfile(depth=100, durability=durability),
        )
    return heard


def check_content(name, message):
    """Whether what a message holds is explained."""
    (section,) = sections()[name]
    if section.type.endswith("/PointCloud2"):
        assert {field.name for field in message.fields} == set(section.names), name
    if section.type.endswith("/DiagnosticArray"):
        for status in message.status:
            for entry in status.values:
                assert entry.key in section.names or entry.key.startswith(f"{status.name}."), (name, entry.key)
    if name == "reading":
        assert set(message.name) <= set(section.names)


def test_topics_services_and_contents_are_those_of_the_running_nodes(bench, finish):
    graph = bench.graph(NODES, site=NOISY)
    operator = bench.operator(graph)
    heard = hear(operator)
    finish(operator)
    collected(operator, 128)
    for service in ("compare", "improve"):
        operator.call(f"estimator/{service}", PATIENCE)
    node = operator._node
    wanted = {f"/{name.strip('/')}" for name in rows()}
    assert operator.wait(lambda: wanted <= {name for name, _ in node.get_topic_names_and_types()}, PATIENCE)
    # this program's own subscriptions make topics too; those of the other nodes are looked at by themselves
    missing = ELSEWHERE | {"truth/table"}
    assert operator.wait(lambda: set(rows()) - missing <= set(heard), PATIENCE), set(rows()) - missing - set(heard)
    check_topics(node)
    for name, message in heard.items():
        check_content(name, message)
    assert len(heard["diagnosis"].status) > 3
    check_services(operator, NODES)


def check_services(operator, names):
    text = "\n".join(PAGES.values())
    assert operator.wait(lambda: all(operator.has_node(name) for name in names), PATIENCE)
    for name in names:
        for service, types in operator._node.get_service_names_and_types_by_node(name, "/"):
            if types == ["std_srvs/srv/Trigger"]:
                assert f"`{service[1:]}`" in text, service


def test_topics_of_the_probe_and_the_player(bench):
    session_to_bag(open_measurement(SESSION), bench.folder / "bag", start=round(ORIGIN * 1e9))
    programs = [
        Program("axis_simulator", {"use_sim_time": True}),
        Program("probe", {"use_sim_time": True}),
        Program("player", {"bag": str(bench.folder / "bag"), "paused": True}),
    ]
    graph = bench.stack.enter_context(Graph(programs, bench.folder / "log", bench.domain))
    operator = bench.operator(graph)
    heard = hear(operator)
    assert operator.wait(lambda: {"instrument/status", "player/status", "truth/table"} <= set(heard), PATIENCE)
    check_topics(operator._node)
    check_services(operator, ("probe", "player"))
    check_content("player/status", heard["player/status"])
    probe = FOLDER.joinpath("probe.md").read_text()
    assert all(f"`{entry.key}`" in probe for entry in heard["instrument/status"].status[0].values)


@pytest.mark.parametrize("name", [*NODES, "probe", "player"])
def test_every_parameter_has_its_row(name):
    source = (SOURCE / f"{name}.py").read_text()
    declared = set(re.findall(r'declare\(\s*self,\s*"(\w+)"', source))
    assert declared
    (page,) = [page for page in PAGES.values() if f"## Parameters of `{name}`\n" in page]
    section = page.split(f"## Parameters of `{name}`\n")[1].split("\n## ")[0]
    lines = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
    assert set(re.findall(r"`(\w+)`", " ".join(lines))) == declared


def test_the_program_on_the_page_hears_a_map_that_was_latched_before(bench):
    operator = bench.operator()
    sender = operator._node.create_publisher(PointCloud2, "error_map", LATCHED)
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
