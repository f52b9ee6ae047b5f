"""msg_docs says what the running nodes do."""

import re
from pathlib import Path

import pytest
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy

from .conftest import begin

FOLDER = Path(__file__).parents[2] / "msg_docs"
NODES = ("axis_simulator", "rotary_pointer", "instrument", "procedure", "estimator")
IGNORED = {"/rosout", "/parameter_events", "/recorder/status"}


def documented():
    """Type and QoS of each topic in the table of README.md."""
    rows = re.findall(r"^\| `([\w/]+)` \| (\w+)/(\w+) \| [^|]+ \| ([^|]+) \|", (FOLDER / "README.md").read_text(), re.M)
    return {name: (f"{package}/msg/{kind}", qos.strip()) for name, package, kind, qos in rows}


def shown(profile):
    words = ["reliable" if profile.reliability == ReliabilityPolicy.RELIABLE else "best effort"]
    if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        words.append("transient local")
    return ", ".join(words)


@pytest.mark.timeout(90)
def test_topics_services_and_parameters_are_those_of_the_running_nodes(bench):
    graph = bench.graph(NODES)
    operator = bench.operator(graph)
    begin(operator)
    node = operator._node
    table = documented()
    assert len(table) >= 28
    wanted = {f"/{name.strip('/')}" for name in table}
    assert operator.wait(lambda: wanted <= {name for name, _ in node.get_topic_names_and_types()}, 10.0)
    for name, types in node.get_topic_names_and_types():
        if name in IGNORED:
            continue
        key = name if name in table else name[1:]
        assert key in table, f"{name} is not in msg_docs/README.md"
        kind, qos = table[key]
        assert types == [kind], name
        for publisher in node.get_publishers_info_by_topic(name):
            assert re.sub(r", depth \d+", "", qos) == shown(publisher.qos_profile), name
            if publisher.qos_profile.history == HistoryPolicy.KEEP_LAST:  # discovery does not always tell
                assert qos.endswith(f"depth {publisher.qos_profile.depth}"), name

    text = "\n".join(page.read_text() for page in FOLDER.glob("*.md"))
    assert operator.wait(lambda: all(operator.has_node(name) for name in NODES), 10.0)
    for name in NODES:
        for service, types in node.get_service_names_and_types_by_node(name, "/"):
            if types == ["std_srvs/srv/Trigger"]:
                assert f"`{service[1:]}`" in text, service


@pytest.mark.timeout(60)
@pytest.mark.parametrize("name", NODES)
def test_every_parameter_has_its_row(name):
    source = (Path(__file__).parents[2] / "src/machine_tool_calibration/nodes" / f"{name}.py").read_text()
    declared = set(re.findall(r'declare\(\s*self,\s*"(\w+)"', source))
    assert declared
    for page in FOLDER.glob("*.md"):
        if f"## Parameters of `{name}`" in page.read_text():
            section = page.read_text().split(f"## Parameters of `{name}`")[1]
            rows = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
            assert set(re.findall(r"`(\w+)`", " ".join(rows))) == declared
            return
    raise AssertionError(f"no page describes the parameters of {name}")
