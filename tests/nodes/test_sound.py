# SPDX-License-Identifier: Apache-2.0
"""Messages that mean nothing are refused before any callback sees them."""

from array import array

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, Quaternion
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Temperature
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.procedure import event_of
from machine_tool_calibration.nodes.ros.messages import stamp_among
from machine_tool_calibration.nodes.ros.sound import require_sound
from machine_tool_calibration.procedure.events import Captured, CaptureFailed, DatumSet

from .hostile import examples
from .pages import rows

NAN, INF = float("nan"), float("inf")


def stamped(sec: int, nanosec: int) -> JointState:
    message = JointState()
    message.header.stamp = Time(sec=sec, nanosec=nanosec)
    return message


def late_point() -> JointTrajectory:
    point = JointTrajectoryPoint(positions=[0.1])
    point.time_from_start.nanosec = 4_000_000_000
    return JointTrajectory(joint_names=["x"], points=[point])


def turned(norm: float) -> PoseStamped:
    message = PoseStamped()
    message.pose.orientation = Quaternion(x=0.0, y=0.0, z=0.0, w=norm)
    return message


REFUSED = [
    (JointState(name=["x", "y"], position=[1.0]), "2 names and 1 positions"),
    (JointState(name=["x"]), "1 names and 0 positions"),
    (JointState(position=[1.0]), "0 names and 1 positions"),
    (JointState(name=["x"], position=[1.0], velocity=[0.0, 0.0]), "1 names and 2 velocities"),
    (JointState(name=["x", "x"], position=[1.0, 2.0]), "a name stands twice"),
    (JointState(name=["x"], position=[INF]), r"position\[0\] is inf"),
    (JointState(name=["x", "y"], position=[NAN, -1e308]), r"position\[1\] is -1e\+308"),
    (stamped(0, 1_000_000_000), "header.stamp is no time: 0 s and 1000000000 ns"),
    (stamped(-1, 0), "header.stamp is no time"),
    (Clock(clock=Time(sec=2**31 - 1)), "clock is no time"),
    (Temperature(temperature=NAN), "temperature is nan"),
    (Temperature(temperature=1e308), r"temperature is 1e\+308"),
    (turned(0.5), "pose.orientation is no rotation"),
    (late_point(), r"points\[0\].time_from_start is no duration"),
    (Float64MultiArray(data=array("d", bytes(8 * 100_001))), "data has 100001 entries"),
    (DiagnosticArray(status=[DiagnosticStatus()] * 100_001), "status has 100001 entries"),
]


@pytest.mark.parametrize(("message", "why"), REFUSED, ids=[why for _, why in REFUSED])
def test_a_message_without_meaning_is_refused(message, why):
    with pytest.raises(CalibrationError, match=why):
        require_sound(message)


@pytest.mark.parametrize("topic", rows())
def test_what_the_pages_show_is_sound(topic):
    for message in examples(topic):
        require_sound(message)


def test_missing_values_and_no_rotation_are_sound():
    require_sound(JointState(name=["displacement"], position=[NAN]))
    require_sound(turned(0.0))
    require_sound(DiagnosticArray(status=[DiagnosticStatus(values=[KeyValue(key="nan", value="inf")])]))


@pytest.mark.parametrize("text", ["", "soon", "-1", "1e9", "inf", "٣", "9" * 400, str(2**31 * 10**9)])
def test_what_a_status_says_is_no_time(text):
    with pytest.raises(CalibrationError, match=r"held is .*, not a time in ns"):
        stamp_among({"held": text}, "held")
    assert stamp_among({"held": "1700000000000000001"}, "held") == 1_700_000_000_000_000_001


GOOD = '"datum": "d-1", "inputs": {"beam": 4}, "start": 3, "end": 7, "stamp": 5'
READING = f'{{{GOOD}, "displacement": 0.5, "environment": {{"temperature_air": 20}}}}'


def asked(message, *, success=True, is_datum=False):
    return event_of(9, success, message, is_datum=is_datum, sensed=lambda stamp: {"temperature_x": float(stamp)})


def test_answers_of_an_instrument_are_events():
    assert asked(f"{{{GOOD}}}", is_datum=True) == DatumSet(9, "d-1", 3, {"beam": 4})
    columns = {"temperature_x": 5.0, "temperature_air": 20.0}
    assert asked(READING) == Captured(9, 5, 3, 7, 0.5, "d-1", columns, {"beam": 4})
    assert asked('{"kind": "beam", "reason": "broken"}', success=False) == CaptureFailed(9, "beam", "broken")


@pytest.mark.parametrize(
    ("part", "wrong"),
    [
        ('"stamp": 5', '"stamp": "soon"'),
        ('"stamp": 5', '"stamp": 1e308'),
        ('"stamp": 5', f'"stamp": {10**30}'),
        ('"end": 7', '"end": -1'),
        ('"displacement": 0.5', '"displacement": 1e999'),
        ('"displacement": 0.5', '"displacement": [1]'),
        ('"temperature_air": 20', '"temperature_air": "warm"'),
        ('{"beam": 4}', "4"),
        (READING, "[" * 100_000),
        (READING, "null"),
    ],
)
def test_an_answer_that_makes_no_sense_is_a_failure(part, wrong):
    assert part in READING
    event = asked(READING.replace(part, wrong))
    assert isinstance(event, CaptureFailed) and event.reason.startswith("not an answer of an instrument")
