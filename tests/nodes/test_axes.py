# SPDX-License-Identifier: Apache-2.0
"""The axis simulator by itself."""

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from machine_tool_calibration.nodes.commanded import Executions
from machine_tool_calibration.nodes.ros.messages import (
    COMMAND,
    STATE,
    duration_message,
    from_message,
    nanoseconds,
    to_message,
    values,
)

from .conftest import ORIGIN, PATIENCE

START = round(ORIGIN * 1e9)


class Axes:
    def __init__(self, operator):
        self.operator = operator
        self.states, self.reports, self.truth, self.executed = [], [], [], []
        node, executions = operator.node, Executions()
        node.create_subscription(JointState, "joint_states", self.states.append, STATE)
        node.create_subscription(DiagnosticArray, "axes/status", self.reports.append, STATE)
        node.create_subscription(
            JointTrajectory, "axes/executed", lambda message: self.executed.append(executions.take(message)), STATE
        )
        node.create_subscription(PoseStamped, "truth/functional_point", self.truth.append, STATE)
        self.publisher = node.create_publisher(JointTrajectory, "axes/joint_trajectory", COMMAND)
        assert operator.wait(lambda: self.states and self.reports, PATIENCE)
        assert operator.wait(lambda: self.publisher.get_subscription_count() > 0, PATIENCE)

    def command(self, stamp, names, *points):
        """Send until it is answered, as the procedure does: a first message may be lost."""
        message = JointTrajectory(joint_names=list(names))
        message.header.stamp = to_message(stamp)
        message.points = [
            JointTrajectoryPoint(positions=list(map(float, place)), time_from_start=duration_message(nanoseconds(time)))
            for place, time in points
        ]

        def answered():
            return any(values(report)["command"] == str(stamp) for report in self.reports)

        def sent():
            self.publisher.publish(message)
            return self.operator.wait(answered, 0.5)

        assert self.operator.wait(sent, PATIENCE)
        return [report for report in self.reports if values(report)["command"] == str(stamp)]

    def done(self, stamp, points):
        """What was executed of a command, once so many of its points have been reached."""

        def reached():
            return self.executed and self.executed[-1].command == stamp and len(self.executed[-1].reached) == points

        assert self.operator.wait(reached, PATIENCE)
        return self.executed[-1]


def test_simulated_time_jumps_to_the_end_of_the_dwell(bench):
    axes = Axes(
        bench.operator(bench.graph(("axis_simulator",), more={"axis_simulator": {"speed": 0.2, "acceleration": 1.0}}))
    )
    stamp = START + 10**9
    report = values(axes.command(stamp, "x", ((0.2,), 0.0), ((0.2,), 3.0))[0])
    assert report["state"] == "arrived"
    executed = axes.done(stamp, 2)
    # 0.2 m at 0.2 m/s and 1 m/s^2
    assert (executed.began, executed.reached) == (stamp, (stamp + 1_200_000_000, stamp + 4_200_000_000))
    assert executed.arrival([{"x": 0.2}, {"x": 0.2}]) == stamp + 1_200_000_000
    assert [place["x"] for place in executed.places] == [0.0, 0.2, 0.2]
    held_until = executed.reached[-1]

    def held():
        return all(
            messages and from_message(messages[-1].header.stamp) == held_until for messages in (axes.states, axes.truth)
        )

    assert axes.operator.wait(held, PATIENCE)
    at = {from_message(state.header.stamp): dict(zip(state.name, state.position, strict=True)) for state in axes.states}
    assert at[held_until] == {"x": 0.2, "y": 0.0, "z": 0.0, "c": 0.0}
    # the command said nothing of the table: who comes to measure it hears where it stands all the same
    table = []
    axes.operator.node.create_subscription(PoseStamped, "truth/table", table.append, STATE)
    assert axes.operator.wait(lambda: table, PATIENCE)
    assert from_message(table[-1].header.stamp) == held_until
    # the true point is off the encoders by the machine's errors: micrometres
    place = axes.truth[-1].pose.position
    assert 0.0 < abs(place.x - 0.2) + abs(place.y) + abs(place.z) < 1e-4


@pytest.mark.long
@pytest.mark.parametrize("simulated_time", [True, False])
def test_commands_outside_the_travel_are_refused(bench, simulated_time):
    axes = Axes(bench.operator(bench.graph(("axis_simulator",), simulated_time=simulated_time)))
    stamp = START + 10**9 if simulated_time else 1
    (report, *_) = axes.command(stamp, "xy", ((0.1, 0.45), 0.0))
    assert values(report)["state"] == "refused"
    assert report.status[0].level == b"\x02"
    assert report.status[0].message == "refused: y = 0.45 is outside its travel 0 to 0.4"
    seen = len(axes.states)
    assert axes.operator.wait(lambda: len(axes.states) > seen + 2, PATIENCE)
    assert set(axes.states[-1].position) == {0.0}
    assert set(axes.states[-1].velocity) == {0.0}


@pytest.mark.long
def test_real_time_motion_keeps_the_limits_and_can_be_stopped(bench):
    # slow, so that even a busy machine stops it well before the end
    limits = {"axis_simulator": {"speed": 0.04, "acceleration": 0.5, "state_rate": 100.0}}
    axes = Axes(bench.operator(bench.graph(("axis_simulator",), simulated_time=False, more=limits)))
    names = axes.states[-1].name
    x = names.index("x")
    axes.command(1, "x", ((0.4,), 0.0))
    assert axes.operator.wait(lambda: axes.states[-1].position[x] > 0.05, PATIENCE)
    axes.command(2, "")
    assert axes.operator.wait(lambda: axes.states[-1].velocity[x] == 0.0, PATIENCE)
    stopped = axes.states[-1].position[x]
    assert 0.05 < stopped < 0.4
    speeds = [abs(state.velocity[x]) for state in axes.states]
    assert 0.039 < max(speeds) <= 0.04 + 1e-9
    # a command that goes back while moving brakes first
    axes.command(3, "x", ((0.0,), 0.0))
    assert axes.operator.wait(lambda: values(axes.reports[-1])["state"] == "arrived", PATIENCE)
    assert axes.operator.wait(lambda: axes.states[-1].position[x] == 0.0, PATIENCE)
    # the true pose at the very end of the motion, between two ticks: nothing creeps after it
    executed = axes.done(3, 1)
    (arrived,) = executed.reached
    assert executed.places[0]["x"] < 0.4 and executed.places[1]["x"] == 0.0

    def true_places():
        return {from_message(pose.header.stamp): pose.pose.position.x for pose in axes.truth}

    assert axes.operator.wait(lambda: arrived in true_places(), PATIENCE)
    at = true_places()
    later = [place for stamp, place in at.items() if stamp >= arrived]
    assert set(later) == {at[arrived]}
