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
from machine_tool_calibration.nodes.ros.messages import Level, dated, stamp_among, status
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


ZEROED = {"datum": "d-1", "start": 3, "end": 7, "input_beam": 4}
READING = {**ZEROED, "displacement": 0.5, "samples": 8, "temperature_air": 20}


def told(found, verb="capture", level=Level.OK):
    message = DiagnosticArray(status=[status(verb, level, "broken", found)])
    return event_of(9, dated(message, 5), lambda stamp: {"temperature_x": float(stamp)})


def test_outcomes_of_an_instrument_are_events():
    assert told(ZEROED, "datum") == DatumSet(9, "d-1", 3, {"beam": 4})
    columns = {"temperature_x": 5.0, "temperature_air": 20.0}
    assert told(READING) == Captured(9, 5, 3, 7, 0.5, "d-1", columns, {"beam": 4})
    assert told({"kind": "beam"}, level=Level.ERROR) == CaptureFailed(9, "beam", "broken")
    assert told({}, level=Level.WARN) == CaptureFailed(9, "other", "broken")


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("start", "soon"),
        ("start", "1e308"),
        ("start", 10**30),
        ("end", -1),
        ("end", None),
        ("displacement", "1e999"),
        ("displacement", "[1]"),
        ("displacement", None),
        ("temperature_air", "warm"),
        ("temperature_air", "-inf"),
        ("input_beam", "4.0"),
        ("datum", None),
    ],
)
def test_an_outcome_that_makes_no_sense_is_a_failure(name, wrong):
    event = told({**READING, name: wrong} if wrong is not None else {k: v for k, v in READING.items() if k != name})
    assert isinstance(event, CaptureFailed) and event.reason.startswith("not an outcome of an instrument")
