# SPDX-License-Identifier: Apache-2.0
"""One measurement in simulated time: its readings, topics, map and recording."""

import json
import subprocess
import sys
from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.nodes.client import Client
from machine_tool_calibration.nodes.heard import SERVICES, Heard
from machine_tool_calibration.nodes.ros.messages import READINGS, from_message
from machine_tool_calibration.recording.cdr import JOINT_STATE, decode
from machine_tool_calibration.recording.graph import GRAPH_TOPICS
from machine_tool_calibration.recording.reader import BagReader
from machine_tool_calibration.recording.session_bag import session_from_bag
from machine_tool_calibration.session.collect import live_session

from .conftest import ORIGIN, PATIENCE, PROCEDURE, SITE, Bench, begin, collected, ended
from .heard import check_content, check_ends, check_services, check_topics, hear
from .pages import rows
from .reference import reference
from .test_measurement import readings, since_first

NODES = ("recorder", "axis_simulator", "rotary_pointer", "instrument", "procedure", "estimator")

EFFECTS = {
    **SITE,
    "effects": [{"id": "backlash_x", "size": 2e-6}],
    "pointer": {"zero_offset": 3e-5, "radial": {"2": [1.0e-6, -0.5e-6]}},
}

# what any program can do: no package of ours, only messages of ROS
SUBSCRIBER = """
import json, struct, sys
import rclpy
from rclpy.qos import QoSProfile, DurabilityPolicy
from sensor_msgs.msg import PointCloud2
rclpy.init()
node = rclpy.create_node("second_program")
got = []
qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_subscription(PointCloud2, "error_map", got.append, qos)
for _ in range(3000):
    rclpy.spin_once(node, timeout_sec=0.1)
    if got:
        break
message = got[0]
fields = [(f.name, f.offset, f.datatype) for f in message.fields]
rows = [struct.unpack_from("<9d", bytes(message.data), i * message.point_step) for i in range(message.width)]
print(json.dumps({"fields": fields, "rows": rows}))
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory, ros_domain):
    """One measurement that is recorded and heard; the estimator comes late, and is asked for everything."""
    bench = Bench(tmp_path_factory.mktemp("whole"), ros_domain)
    with bench.stack:
        graph = bench.graph(NODES, site=EFFECTS)
        graph.stop(["estimator"])
        operator = bench.operator(graph)
        heard = hear(operator)
        stamps = []
        operator.node.create_subscription(
            JointState, "reading", lambda message: stamps.append(from_message(message.header.stamp) * 1e-9), READINGS
        )
        beside = Heard()
        listener = bench.stack.enter_context(closing(Client(ros_domain, heard=beside).listen()))
        assert operator.wait(lambda: operator.heard.said("recorder").message == "recording", PATIENCE)
        begin(operator)
        ended(operator)
        assert operator.wait(lambda: len(operator.heard.session()[1]) >= 72, PATIENCE)
        graph.start("estimator")  # one that comes late gets every reading
        collected(operator, 72)
        identified = operator.outcome("estimator/identify", PATIENCE)
        assert operator.wait(
            lambda: bool(operator.heard.published.document) and operator.heard.published.error_map, PATIENCE
        )
        first = operator.heard.published.document
        printed = subprocess.run(
            [sys.executable, "-c", SUBSCRIBER], capture_output=True, text=True, timeout=900, check=True
        )
        operator.outcome("estimator/compare", PATIENCE)
        improved = operator.outcome("estimator/improve", PATIENCE)
        assert operator.wait(lambda: operator.heard.published.document != first, PATIENCE)
        yield SimpleNamespace(
            graph=graph, operator=operator, heard=heard, identified=identified, document=json.loads(first),
            beside=beside, listener=listener, stamps=stamps,
            second_program=json.loads(printed.stdout), improved=improved,
            bag=bench.folder / "bag1", logs=bench.folder / "log1",
        )  # fmt: skip


def test_readings_are_those_of_the_simulator(whole):
    operator = whole.operator
    table = readings(operator)
    expected = reference(PROCEDURE, EFFECTS)
    assert np.abs(since_first(operator, table["displacement"]) - expected).max() < 1e-12
    assert np.ptp(expected) > 0.1
    assert set(table["dir_x"]) == {-1.0, 1.0}
    assert operator.procedure.number("recoveries") == 0
    assert all(np.diff(table["time"]) > 0)
    assert np.allclose(np.diff(whole.stamps), np.diff(table["time"]), atol=1e-6)
    assert {"temperature_air", "temperature_work", "air_pressure", "relative_humidity"} <= set(table)


def test_the_map_reaches_a_second_program(whole):
    assert whole.identified["observations"] == whole.identified["used"] == "72"
    latched = whole.second_program
    assert [name for name, _, _ in latched["fields"]] == ["x", "y", "z", "ex", "ey", "ez", "ux", "uy", "uz"]
    assert all(kind == 8 for _, _, kind in latched["fields"])  # FLOAT64
    table = np.array(latched["rows"])
    assert table[:, 3:5].tolist() == [row[:2] for row in whole.document["error_map"]["position_error"]]
    assert np.isnan(table[:, 5]).all()  # the plane says nothing of z


def test_topics_services_and_contents_are_those_of_the_documents(whole):
    operator, heard = whole.operator, whole.heard
    node = operator.node
    wanted = {f"/{name.strip('/')}" for name in rows()}
    assert operator.wait(lambda: wanted <= {name for name, _ in node.get_topic_names_and_types()}, PATIENCE)
    # this program's own subscriptions make topics too; those of the other nodes are looked at by themselves
    missing = {"probe/trigger", "player/status", "truth/table", "until/status"}
    assert operator.wait(lambda: set(rows()) - missing <= set(heard), PATIENCE), set(rows()) - missing - set(heard)
    check_topics(node)
    for name, message in heard.items():
        check_content(name, message)
    assert len(heard["diagnosis"].status) > 3
    check_services(operator, NODES)
    check_ends(operator, NODES)


def test_diagnostics_name_every_node_and_its_device(whole):
    told = {}

    def keep(message):
        told.update((status.name, status) for status in message.status)

    whole.operator.node.create_subscription(DiagnosticArray, "/diagnostics", keep, 10)
    names = {f"{name}: {name}" for name in NODES if name not in ("axis_simulator", "rotary_pointer")}
    names |= {"axis_simulator: axes", "rotary_pointer: pointer"}
    assert whole.operator.wait(lambda: names <= set(told), PATIENCE), names - set(told)
    assert set(told) == names
    assert told["axis_simulator: axes"].hardware_id == "simulated machine w-C-b-Y-X-Z-t"
    assert told["instrument: instrument"].hardware_id == "simulated interferometer"
    assert told["estimator: estimator"].hardware_id == "none"
    assert told["estimator: estimator"].values == whole.heard["estimator/status"].status[0].values


def test_a_listener_hears_the_readings_the_nodes_and_the_map_and_asks(whole):
    beside, operator = whole.beside, whole.operator
    assert operator.wait(lambda: beside.published.document == operator.heard.published.document, PATIENCE)
    assert operator.wait(lambda: beside.count[1] == 72, PATIENCE)
    _, _, rows = beside.rows(-1, 0)
    table = readings(operator)
    assert rows == list(zip(table["setup_index"].astype(int).tolist(), table["displacement"].tolist(), strict=True))
    assert len(live_session(*beside.session()).readings) == 72 and beside.missing == 0
    columns = {name: values.tolist() for name, values in beside.published.error_map.items()}
    heard = json.loads(operator.heard.published.document)["error_map"]
    assert list(zip(columns["ex"], columns["ey"], strict=True)) == [tuple(row[:2]) for row in heard["position_error"]]
    assert len(beside.published.residuals["residual"]) == 72
    assert operator.wait(lambda: {one.node for one in beside.nodes()} == set(NODES), PATIENCE), beside.nodes()
    assert beside.ignored == (0, "")
    wanted = {f"{node}/{verb}" for node, verbs in SERVICES.items() for verb in verbs}
    assert operator.wait(lambda: {offer.service for offer in beside.offers} == wanted, PATIENCE), beside.offers
    (compare,) = [offer for offer in beside.offers if offer.verb == "compare"]
    whole.listener.ask(compare)
    assert operator.wait(lambda: beside.calls[0].success is not None, PATIENCE)
    assert beside.calls[0].success and beside.calls[0].message.startswith("compared: ")


def test_nothing_that_was_planned_is_warned_of(whole):
    said = "".join(file.read_text() for file in sorted(whole.logs.glob("*.log")))
    assert "[recorder]: recording to" in said
    assert "[WARN]" not in said and "[ERROR]" not in said


@pytest.mark.long
def test_a_recording_in_simulated_time_holds_everything_at_its_time(whole):
    whole.graph.stop(["recorder"])  # which takes what has come
    bag = BagReader(whole.bag)
    # whatever was published is there, the probe's trigger and the clock excepted
    assert {topic.name for topic in GRAPH_TOPICS} - {name[1:] for name in bag.topics} <= {
        "probe/trigger",
        "truth/table",
        "until/status",
    }
    assert bag.topics["/reading"].qos[0].depth == 20000  # so that a replay latches them all
    begin, end = (round((ORIGIN + seconds) * 1e9) for seconds in (0.0, 600.0))
    times = [message.log_time for message in bag.messages()]
    assert begin <= min(times) and max(times) < end
    # a reading is captured at the end of the dwell, and logged before the next move ends
    readings = [(m.log_time, decode(JOINT_STATE, m.data).header.stamp) for m in bag.messages(["/reading"])]
    late = np.array([(logged - stamp.sec * 10**9 - stamp.nanosec) * 1e-9 for logged, stamp in readings])
    assert len(late) == 72 and np.median(late) == pytest.approx(0.05, abs=1e-6)
    for message in bag.messages():
        header = getattr(bag.decode(message), "header", None)
        if header is not None:
            assert header.stamp.sec > 0, message.topic
            assert header.frame_id not in ("A", "B", "C", "D"), message.topic
    session = session_from_bag(whole.bag)
    effects = whole.improved["effects"].split()
    assert "backlash_x" in effects
    assert json.loads(whole.operator.heard.published.document) == identify(session, effects=effects).document()
