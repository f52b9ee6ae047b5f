# SPDX-License-Identifier: Apache-2.0
"""No message ends a node, whoever sends it: all callbacks in this process, and a running graph that measures on."""

import re
from array import array
from pathlib import Path

import numpy as np
import pytest
import rclpy
import yaml
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.axis_simulator import AxisSimulator
from machine_tool_calibration.nodes.estimator import Estimator
from machine_tool_calibration.nodes.graph import free_domain
from machine_tool_calibration.nodes.instrument import Instrument
from machine_tool_calibration.nodes.probe import Probe
from machine_tool_calibration.nodes.procedure import ProcedureNode
from machine_tool_calibration.nodes.recorder import Recorder
from machine_tool_calibration.nodes.ros.sound import require_sound
from machine_tool_calibration.nodes.rotary_pointer import RotaryPointer

from .conftest import PATIENCE, PROCEDURE, SITE, begin, ended
from .hostile import examples, mutated
from .pages import rows
from .reference import reference
from .test_measurement import readings, since_first

NODES = (AxisSimulator, RotaryPointer, Instrument, Probe, ProcedureNode, Estimator, Recorder)


def is_sound(message):
    try:
        require_sound(message)
    except CalibrationError:
        return False
    return True


def _qos(depth, *, latched):
    return QoSProfile(
        depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    )


def subscribed(node):
    """Callbacks of a node's subscriptions, by topic."""
    found = {subscription.topic_name: subscription.callback for subscription in node.subscriptions}
    return {name if name in rows() else name[1:]: callback for name, callback in found.items()}


@pytest.fixture(scope="module", params=["true", "false"], ids=["simulated time", "real time"])
def nodes(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile")
    parameters = {"use_sim_time": request.param, "folder": folder / "bag"}
    for name, content in (("site", SITE), ("procedure", PROCEDURE)):
        parameters[name] = folder / f"{name}.yaml"
        parameters[name].write_text(yaml.safe_dump(content))
    arguments = ["--ros-args"]
    for name, value in parameters.items():
        arguments += ["-p", f"{name}:={value}"]
    # in a domain of their own: what they said last must not be taken for a word of the graph below
    with free_domain(range(1, 102)) as domain:
        rclpy.init(args=arguments, domain_id=domain)
        made = {kind: kind() for kind in NODES}
        for node in made.values():
            node.start()
        yield made
        for node in made.values():
            node.trigger_shutdown()
            node.destroy_node()
        rclpy.shutdown()


@pytest.mark.long(but=[f"simulated time-{kind.__name__}" for kind in NODES])
@pytest.mark.parametrize("kind", NODES)
def test_no_message_ends_a_node(nodes, kind):
    node = nodes[kind]
    callbacks = subscribed(node)
    for topic in callbacks:
        for message in examples(topic):
            callbacks[topic](serialize_message(message))
    assert not node.ignored
    if kind is ProcedureNode:
        node._start()
    sent = wrong = 0
    for topic, callback in callbacks.items():
        for example in examples(topic):
            for _, message in mutated(example):
                callback(serialize_message(message))
                sent, wrong = sent + 1, wrong + (not is_sound(message))
    for timer in node.timers:
        timer.callback()
    assert not node._failed  # no timer stumbles over what a message left behind
    ignored = node.ignored_entries
    assert wrong <= ignored["ignored"] <= sent
    if callbacks:  # a recorder in real time listens by its taps only
        assert wrong and ignored["ignored_last"].split(":")[0] in callbacks


def a_large_message_costs_no_lasting_memory(operator, graph):
    """By default the middleware would keep the room that it took."""

    def resident():
        status = Path("/proc", str(graph.process_id("procedure")), "status").read_text()
        return int(re.search(r"VmRSS:\s+(\d+) kB", status)[1]) / 1000

    publisher = operator.node.create_publisher(JointState, "joint_states", _qos(1, latched=False))
    assert operator.wait(publisher.get_subscription_count, PATIENCE)
    assert operator.wait(lambda: operator.procedure.entries.get("waiting_for") == "", PATIENCE), operator.procedure
    before = resident()
    large = JointState(position=array("d", bytes(50_000_000)))
    while not operator.procedure.number("ignored"):  # the first ones come before the subscription is matched
        publisher.publish(large)
        operator.wait(lambda: operator.procedure.number("ignored") > 0, 2.0)
    operator.node.destroy_publisher(publisher)
    assert "it has 50000036 bytes" in operator.procedure.entries["ignored_last"]
    assert operator.wait(lambda: resident() < before + 25.0, PATIENCE)  # MB: half of one


@pytest.mark.long
def test_a_graph_measures_on_whatever_else_is_said_on_its_topics(bench):
    graph = bench.graph(("axis_simulator", "rotary_pointer", "instrument", "procedure", "estimator"))
    operator = bench.operator(graph)
    node = operator.node
    spoilt = []
    for topic, row in rows().items():
        for example in examples(topic):
            known = [
                serialize_message(message)
                for _, message in mutated(example)
                # one that makes sense says that others move the axes: then the procedure rightly measures anew
                if not is_sound(message) or topic == "axes/status"
            ]
            depth, latched = int(row.qos.rpartition(" ")[2]), "transient local" in row.qos
            publisher = node.create_publisher(type(example), topic, _qos(depth, latched=latched)) if known else None
            spoilt += [(publisher, message) for message in known]
    a_large_message_costs_no_lasting_memory(operator, graph)
    begin(operator)
    share = len(spoilt) // 100 + 1
    said = 0
    while spoilt:
        said += operator.procedure.entries["state"] == "running"
        for publisher, message in spoilt[:share]:
            publisher.publish(message)
        del spoilt[:share]
        operator.wait(lambda: False, 0.01)
    ended(operator)
    assert said
    assert operator.wait(lambda: operator.heard.said("estimator").number("readings") == 72, PATIENCE)
    assert operator.wait(lambda: len(operator.heard.session()[1]) == 72, PATIENCE)
    table = readings(operator)
    assert np.abs(since_first(operator, table["displacement"]) - reference(PROCEDURE, SITE)).max() < 1e-9
    assert operator.wait(
        lambda: operator.procedure.number("ignored") > 50 < operator.heard.said("estimator").number("ignored"), PATIENCE
    )
    graph.check()  # all are alive
