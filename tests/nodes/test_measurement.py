"""The whole graph in simulated time."""

import copy
import json
import subprocess
import sys

import numpy as np
import pytest

from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.recording.cdr import joint_state
from machine_tool_calibration.recording.graph import GRAPH_TOPICS
from machine_tool_calibration.recording.reader import BagReader
from machine_tool_calibration.recording.session_from_bag import session_from_bag

from .conftest import ORIGIN, PATIENCE, PROCEDURE, SITE, collected
from .reference import reference

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
for _ in range(600):
    rclpy.spin_once(node, timeout_sec=0.1)
    if got:
        break
message = got[0]
fields = [(f.name, f.offset, f.datatype) for f in message.fields]
rows = [struct.unpack_from("<9d", bytes(message.data), i * message.point_step) for i in range(message.width)]
print(json.dumps({"fields": fields, "rows": rows}))
"""


def readings(operator):
    names = list(operator.readings[0].name)
    table = np.array([list(message.position) for message in operator.readings])
    return {name: table[:, index] for index, name in enumerate(names)}


def since_first(operator, displacement):
    setups = [message.header.frame_id for message in operator.readings]
    first = {}
    for setup, value in zip(setups, displacement, strict=True):
        first.setdefault(setup, value)
    return displacement - np.array([first[setup] for setup in setups])


def test_readings_are_those_of_the_simulator_and_the_map_reaches_a_second_program(bench, finish):
    graph = bench.graph(("axis_simulator", "rotary_pointer", "instrument", "procedure", "estimator"), site=EFFECTS)
    graph.stop(["estimator"])
    operator = bench.operator(graph)
    finish(operator)
    graph.start("estimator")  # one that comes late gets every reading
    table = readings(operator)
    expected = reference(PROCEDURE, EFFECTS)
    assert np.abs(since_first(operator, table["displacement"]) - expected).max() < 1e-12
    assert np.ptp(expected) > 0.1
    assert set(table["dir_x"]) == {-1.0, 1.0}
    assert operator.procedure.number("recoveries") == 0
    assert all(np.diff(table["time"]) > 0)
    stamps = [message.header.stamp.sec + message.header.stamp.nanosec * 1e-9 for message in operator.readings]
    assert np.allclose(np.diff(stamps), np.diff(table["time"]), atol=1e-6)
    assert {"temperature_air", "temperature_work", "air_pressure", "relative_humidity"} <= set(table)

    collected(operator, 128)
    summary = json.loads(operator.call("estimator/identify", PATIENCE))
    assert summary["observations"] == summary["used"] == 128
    assert operator.wait(lambda: bool(operator.document) and operator.error_map is not None, PATIENCE)
    document = json.loads(operator.document)
    printed = subprocess.run(
        [sys.executable, "-c", SUBSCRIBER], capture_output=True, text=True, timeout=900, check=True
    )
    latched = json.loads(printed.stdout)
    assert [name for name, _, _ in latched["fields"]] == ["x", "y", "z", "ex", "ey", "ez", "ux", "uy", "uz"]
    assert all(kind == 8 for _, _, kind in latched["fields"])  # FLOAT64
    rows = np.array(latched["rows"])
    assert rows[:, 3:5].tolist() == [row[:2] for row in document["error_map"]["position_error"]]
    assert np.isnan(rows[:, 5]).all()  # the plane says nothing of z


def test_a_recording_in_simulated_time_holds_everything_at_its_time(bench, finish):
    names = ("recorder", "axis_simulator", "rotary_pointer", "instrument", "procedure", "estimator")
    graph = bench.graph(names, site={**EFFECTS, "noise": 3e-7})
    operator = bench.operator(graph)
    finish(operator)
    collected(operator, 128)
    operator.call("estimator/compare", PATIENCE)
    improved = json.loads(operator.call("estimator/improve", PATIENCE))
    assert operator.wait(lambda: bool(operator.document), PATIENCE)
    graph.stop(["recorder"])  # which takes what has come
    bag = BagReader(bench.folder / "bag1")
    # whatever was published is there, the probe's trigger and the clock excepted
    assert {topic.name for topic in GRAPH_TOPICS} - {name[1:] for name in bag.topics} <= {
        "probe/trigger",
        "truth/table",
    }
    assert bag.topics["/reading"].qos[0].depth == 20000  # so that a replay latches them all
    begin, end = (round((ORIGIN + seconds) * 1e9) for seconds in (0.0, 600.0))
    times = [message.log_time for message in bag.messages()]
    assert begin <= min(times) and max(times) < end
    # a reading is captured at the end of the dwell, and logged before the next move ends
    stamped = [(message.log_time, joint_state(message.data).stamp) for message in bag.messages(["/reading"])]
    late = np.array([(logged - stamp) * 1e-9 for logged, stamp in stamped])
    assert len(late) == 128 and np.median(late) == pytest.approx(0.05, abs=1e-6)
    session = session_from_bag(bench.folder / "bag1")
    assert "backlash_x" in improved["effects"]
    # But for the map, which is over the sets of effects that the readings do not tell apart.
    over = {"averaged_over", "error_map"}
    own, published = identify(session, effects=improved["effects"]).document(), json.loads(operator.document)
    assert {k: v for k, v in own.items() if k not in over} == {k: v for k, v in published.items() if k not in over}


def test_two_graphs_in_one_domain(bench, finish):
    other = {**SITE, "machine": {**SITE["machine"], "seed": 78}}
    first = bench.graph(namespace="cell_1")
    second = bench.graph(namespace="cell_2", site=other)
    operators = bench.operator(first), bench.operator(second)
    for operator in operators:
        finish(operator)
    for operator, site in zip(operators, (SITE, other), strict=True):
        table = readings(operator)
        assert len(operator.readings) == 128
        assert np.abs(since_first(operator, table["displacement"]) - reference(PROCEDURE, site)).max() < 1e-12


def test_real_time_gives_the_same_readings(bench, finish):
    procedure = copy.deepcopy(PROCEDURE)
    procedure["session"]["repeats"] = 1
    procedure["session"]["setups"] = procedure["session"]["setups"][:2]
    procedure["path"]["grid"]["x"]["count"] = procedure["path"]["grid"]["y"]["count"] = 2
    procedure["motion"]["dwell"] = 0.3
    graph = bench.graph(procedure=procedure, simulated_time=False)
    operator = bench.operator(graph)
    finish(operator)
    displacement = since_first(operator, readings(operator)["displacement"])
    assert np.abs(displacement - reference(procedure, SITE)).max() < 1e-10
    # each reading was taken while the axes stood: later than the move and the averaging take
    assert np.diff(readings(operator)["time"]).min() > 0.2
