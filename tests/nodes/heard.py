# SPDX-License-Identifier: Apache-2.0
"""What running nodes publish and serve, held against msg_docs."""

import re
from importlib import import_module

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from .conftest import PATIENCE
from .pages import PAGES, rows, sections

IGNORED = {"/rosout", "/parameter_events"}
TRANSITIONS = "/transition_event"  # of every managed node


def shown(profile):
    words = ["reliable" if profile.reliability == ReliabilityPolicy.RELIABLE else "best effort"]
    if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        words.append("transient local")
    return ", ".join(words)


def check_topics(node):
    """Whether the topics that there are have the type and the QoS of the table."""
    table = rows()
    for name, types in node.get_topic_names_and_types():
        if name in IGNORED or name.endswith(TRANSITIONS):
            continue
        key = name if name in table else name[1:]
        assert key in table, f"{name} is not in msg_docs/README.md"
        assert types == [table[key].type], name
        for publisher in node.get_publishers_info_by_topic(name):
            assert re.sub(r", depth \d+", "", table[key].qos) == shown(publisher.qos_profile), name
            if publisher.qos_profile.history == HistoryPolicy.KEEP_LAST:  # discovery does not always tell
                assert table[key].qos.endswith(f"depth {publisher.qos_profile.depth}"), name


def check_ends(operator, names):
    """Whether the table says of each of these nodes what it publishes, and what it listens to."""
    node = operator.node
    # Who is there is discovered in its own time.
    assert operator.wait(lambda: set(names) <= set(node.get_node_names()), PATIENCE), node.get_node_names()
    for name in names:
        for ends, found in (
            ("publishers", node.get_publisher_names_and_types_by_node),
            ("subscribers", node.get_subscriber_names_and_types_by_node),
        ):
            told = {f"/{topic.strip('/')}" for topic, row in rows().items() if name in getattr(row, ends)}
            also = IGNORED | ({"/clock"} if ends == "subscribers" or name == "axis_simulator" else set())
            if name == "procedure":
                also |= {"/joint_states"}  # it listens until it starts

            def there(name=name, found=found, also=also):
                return {topic for topic, _ in found(name, "/") if not topic.endswith(TRANSITIONS)} - also

            operator.wait(lambda there=there, told=told - also: there() == told, PATIENCE)
            assert there() == told - also, (name, ends)


def hear(operator):
    """Subscribe to every topic; gives the newest message of each, by name."""
    heard = {}
    for name, row in rows().items():
        package, _, kind = row.type.split("/")
        latched = "transient local" in row.qos
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        operator.node.create_subscription(
            getattr(import_module(f"{package}.msg"), kind),
            name,
            lambda message, name=name: heard.__setitem__(name, message),
            QoSProfile(depth=100, durability=durability),
        )
    return heard


def check_content(name, message):
    """Whether what a message holds is explained."""
    (section,) = sections()[name]
    header = getattr(message, "header", None)
    if header is not None and "`machine`" in section.facts["frame"]:
        assert header.frame_id == "machine", name
    if section.type.endswith("/PointCloud2"):
        assert {field.name for field in message.fields} == set(section.names), name
    if name == "/diagnostics":  # of any node: the values are those of its own status
        assert all(": " in status.name and status.hardware_id for status in message.status)
    elif section.type.endswith("/DiagnosticArray"):
        for status in message.status:
            for entry in status.values:
                assert entry.key in section.names or entry.key.startswith(f"{status.name}."), (name, entry.key)
    if name == "reading":
        assert set(message.name) <= set(section.names)


def check_services(operator, names):
    text = "\n".join(PAGES.values())
    assert operator.wait(lambda: all(operator.has_node(name) for name in names), PATIENCE)
    for name in names:
        for service, types in operator.node.get_service_names_and_types_by_node(name, "/"):
            if types == ["std_srvs/srv/Trigger"]:
                assert f"`{service[1:]}`" in text, service
