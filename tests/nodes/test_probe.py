# SPDX-License-Identifier: Apache-2.0
"""Probing live: the probe node with the axis simulator and the procedure, in simulated and in real time."""

import json
import os
import re
import signal
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="the graph needs ROS 2")

from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.instruments.touch import Part
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.nodes import measurement
from machine_tool_calibration.nodes.commanded import executed_message
from machine_tool_calibration.nodes.ros.messages import COMMAND, LATCHED, STATE, from_message, joint_state
from machine_tool_calibration.session.collect import live_session
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.parse import parse_description
from machine_tool_calibration.simulation.probing_run import cam

from .conftest import ORIGIN, PATIENCE, WHOLE, begin, ended
from .forked import ForkedGraph

TRAVEL = {"x": [-0.13, 0.13], "y": [-0.13, 0.13], "z": [-0.05, 0.05]}
NODES = [-0.132, -0.066, 0.0, 0.066, 0.132]
FORM = 3e-6
SEED = 9


def procedure(points=None, angles=(0.0, 0.9, 2.0, 3.7, 5.1), **session):
    part = cam(count=24) if points is None else points
    return {
        "format": "mtcal-procedure/1",
        "name": "probing_small",
        "session": {
            "method": "probing",
            "machine": {
                "chain": "w-C-b-Y-X-Z-t",
                "rotation_sign": -1,
                "travel": TRAVEL,
                "table_grid": {"x": NODES, "y": NODES},
            },
            "probe": {"stylus_diameter": 0.006},
            "workpiece": [
                {"id": p.id, "feature": p.feature, "position": list(p.position), "normal": list(p.normal)} for p in part
            ],
            "setups": [{"id": f"C{k + 1}", "c": c} for k, c in enumerate(angles)],
            "standard_uncertainty": {"displacement": 1e-6},
            **session,
        },
        "path": {"points": [{"z": -0.01}]},
        "motion": {"speed": {"z": 0.2}, "dwell": 0.1, "approach": 0.004},
    }


def site(effects=(), **machine):
    return {
        "seed": SEED,
        "noise": 0.0,
        "effects": list(effects),
        "machine": {"chain": "w-C-b-Y-X-Z-t", "travel": TRAVEL, "random": None, **machine},
    }


def start(bench, content, world, names=("axis_simulator", "probe", "procedure"), *, simulated=True, **probe):
    file, place = bench.write("procedure.yaml", content), bench.write("site.yaml", world)
    common = {"use_sim_time": simulated, "site": place, "time_origin": ORIGIN if simulated else 0.0}
    parameters = {
        "axis_simulator": common,
        "probe": {**common, "form": FORM, **probe},
        "procedure": {"use_sim_time": simulated, "procedure": file, "patience": PATIENCE, "resend": 0.2},
    }
    nodes = {name: parameters[name] for name in names}
    graph = bench.stack.enter_context(ForkedGraph(nodes, bench.folder / "log", bench.domain))
    return graph, bench.operator(graph)


@pytest.mark.long
def test_live_readings_give_the_part_and_the_machine_back(bench, finish):
    exx = {"nodes": NODES, "values": [2e-6, -1e-6, 0.0, 3e-6, 4e-6], "interpolation": "linear"}
    ecc = {"nodes": [0.0, 2.0, 6.0], "values": [0.0, 1.2e-5, -4e-6], "interpolation": "linear"}
    world = site(squareness={"C0Y": 2e-5}, motions={"EXX": exx, "ECC": ecc})
    known = {"EXX": {"position": 0.066, "value": 3e-6, "standard_uncertainty": 1e-9}}
    _, operator = start(bench, procedure(known=known), world)
    finish(operator)
    session = live_session(*operator.heard.session())
    readings = session.readings
    count = 24 + 16
    assert len(readings) == 5 * count
    assert list(readings.labels["point"][:count]) == [p.id for p in session.description.workpiece]
    # X and Y are those of the sphere's centre at the nominal surface
    first = session.description.workpiece[0]
    assert readings.columns["x"][0] == pytest.approx(first.position[0] + 0.003 * first.normal[0], abs=1e-12)
    assert np.all(np.diff(readings.columns["time"]) > 0)
    assert {"temperature_work", "air_pressure"} <= set(readings.columns)

    result = identify(session)
    document = result.document()
    assert document["reduced_chi_square"] < 1e-4
    found = {entry["name"]: entry["value"] for entry in document["parameters"]}
    # the part's own surface is curved where the probe takes it for flat: nanometres
    assert found["EXX(-0.066)"] == pytest.approx(-1e-6, abs=1e-8)
    # a turn of the tables' Y against X is squareness, whatever the frame
    assert found["C0Y"] == pytest.approx(2e-5, abs=2e-7)
    np.testing.assert_allclose(
        document["error_map"]["ECC"], np.interp([0.0, 0.9, 2.0, 3.7, 5.1], ecc["nodes"], ecc["values"]), atol=2e-7
    )
    form = FORM * np.random.default_rng([SEED, 41]).normal(size=count)
    points = session.description.workpiece
    place, normal = np.array([p.position for p in points]), np.array([p.normal for p in points])
    motion = np.column_stack([normal, place[:, 0] * normal[:, 1] - place[:, 1] * normal[:, 0]])
    difference = np.array(document["error_map"]["workpiece_form"]) - form
    difference -= motion @ np.linalg.lstsq(motion, difference, rcond=None)[0]
    assert np.abs(difference).max() < 1e-8


@pytest.mark.long
def test_missed_and_early_touches_are_reported_and_not_used(bench, finish):
    graph, operator = start(bench, procedure(), site(), form=1.5e-3)
    finish(operator)
    form = 1.5e-3 * np.random.default_rng([SEED, 41]).normal(size=40)
    bad = np.abs(form) > 1e-3
    assert bad.any() and not bad.all()
    session = live_session(*operator.heard.session())
    given = np.isfinite(session.readings.displacement).reshape(5, 40)
    assert np.array_equal(given, np.tile(~bad, (5, 1)))
    log = (bench.folder / "log" / "probe.log").read_text()
    assert "touch too early" in log and "missed touch" in log
    document = identify(session).document()
    assert document["used"] == given.sum()
    assert {entry["row"] for entry in document["rejected"]} == set(np.flatnonzero(~given.ravel()))
    graph.check()


@pytest.mark.long
def test_pretravel_depends_on_the_direction_of_the_contact(bench, finish):
    points = cam(count=12, spheres=False)
    lobes = {"orders": [3], "weights": [1.0], "phases": [0.0]}
    world = site([{"id": "probe_pretravel", "size": 2e-6, "parameters": lobes}])
    _, operator = start(bench, procedure(points, angles=(0.0, 1.0, 2.3)), world, form=0.0)
    refused_in_front_of_nothing(operator)
    finish(operator)
    session = live_session(*operator.heard.session())
    angle = np.array([np.arctan2(*p.normal[::-1]) for p in points])
    expected = 2e-6 * np.cos(3 * (angle[None, :] - np.array([0.0, 1.0, 2.3])[:, None]))
    np.testing.assert_allclose(session.readings.displacement.reshape(3, 12), expected, atol=1e-12)


@pytest.mark.long
def test_in_real_time_the_stylus_approaches_triggers_and_backs_off(bench, finish):
    content = procedure(cam(count=2, spheres=False)[:1], angles=(0.0, 0.5))
    content["motion"] = {"speed": {"x": 0.5, "y": 0.5, "z": 0.5, "c": 2.0}, "dwell": 0.1, "approach": 0.004}
    _, operator = start(bench, content, site(), simulated=False, speed=0.04)
    finish(operator)
    session = live_session(*operator.heard.session())
    form = FORM * np.random.default_rng([SEED, 41]).normal()
    np.testing.assert_allclose(session.readings.displacement, [form, form], atol=1e-9)
    # 4 mm there at 40 mm/s, and as much back
    assert np.all(np.diff(session.readings.columns["time"]) > 0.2)


@pytest.mark.long
def test_a_run_whose_probe_dies_says_so_and_keeps_its_readings(bench, monkeypatch):
    graphs = []

    class Watched(ForkedGraph):
        def __enter__(self):
            graphs.append(self)
            return super().__enter__()

    def progress(text, done, total):
        if done >= 30 and not graphs[0].ended():
            os.kill(graphs[0].process_id("probe"), signal.SIGKILL)

    monkeypatch.setattr(measurement, "Graph", Watched)
    output = bench.folder / "run"
    setting = measurement.Setting(output, domain=bench.domain, record=False)
    with pytest.raises(
        CalibrationError, match=r"^probe was ended by SIGKILL.*; \d+ of 200 readings are kept in "
    ) as dead:
        measurement.measure(Path(bench.write("probing.yaml", procedure())), setting, progress)
    count = int(re.search(r"(\d+) of 200", str(dead.value))[1])
    assert 30 <= count < 200
    assert len(read_session(output / "session", check=False).readings) == count


class PlayedAxes:
    """Axes that stand in front of the part's first point and note what they are told, which they do while `obeying`."""

    def __init__(self, operator, content):
        node, stamp = operator.node, round(ORIGIN * 1e9)
        described = json.dumps({"format": "mtcal-session/1", **content["session"]})
        description = parse_description(described, "session")
        c = description.setups[0].c
        touch = Part(description).touch(0, c, 0.004)
        self.place = {**touch.at(0.004), "z": -0.01, "c": c}
        self.commands, self.obeying = [], True
        self.stamp, self.executed = stamp, executed_message(stamp, [(stamp, self.place)])
        session = node.create_publisher(String, "session", LATCHED)
        states = node.create_publisher(JointState, "joint_states", STATE)
        executed = node.create_publisher(JointTrajectory, "axes/executed", STATE)
        node.create_subscription(JointTrajectory, "axes/joint_trajectory", self._told, COMMAND)
        session.publish(String(data=described))

        def tell():
            executed.publish(self.executed)
            states.publish(joint_state(self.stamp, self.place))

        node.create_timer(0.05, tell)

    def _told(self, command):
        self.commands.append(command)
        if self.obeying:
            began = from_message(command.header.stamp)
            self.stamp = began + 2
            self.executed = executed_message(began, [(began + k, self.place) for k in range(3)])


def played(bench):
    """A touch that axes do not carry out which the probe has heard of: they have carried out the one before."""
    _, operator = start(bench, procedure(), site(), names=("probe",), simulated=False)
    axes = PlayedAxes(operator, procedure())

    def touched():
        with suppress(CalibrationError):  # it has not heard of session or axes yet
            return bool(operator.outcome("instrument/capture", PATIENCE))
        return False

    assert operator.wait(touched, PATIENCE)
    axes.obeying = False
    done = axes.commands[-1]
    asked = operator.client("instrument/capture").call_async(Trigger.Request())
    assert operator.wait(lambda: axes.commands[-1] != done, PATIENCE)
    return operator, axes, asked


@pytest.mark.long
def test_a_command_that_the_axes_did_not_hear_is_sent_again(bench):
    operator, axes, _ = played(bench)
    first = axes.commands.pop()
    axes.commands.clear()
    assert operator.wait(lambda: bool(axes.commands), PATIENCE)
    assert axes.commands[0] == first
    assert from_message(first.header.stamp) % 2 == 1  # no command of a procedure has it


@pytest.mark.long
def test_axes_that_were_started_anew_end_the_touch(bench):
    operator, axes, asked = played(bench)
    assert not asked.done()
    axes.executed = executed_message(axes.stamp + 5, ())
    assert operator.wait(asked.done, PATIENCE)
    assert "started anew" in asked.result().message


def refused_in_front_of_nothing(operator):
    """A probe that is not at a point yet says so."""
    assert operator.wait(lambda: operator.procedure.entries.get("state") == "idle", PATIENCE)
    assert operator.wait(lambda: not operator.procedure.entries["waiting_for"], PATIENCE)
    with pytest.raises(CalibrationError, match="in front of no point"):
        operator.call("instrument/capture", PATIENCE)


@pytest.mark.long
def test_a_probe_that_is_restarted_pairs_nothing_wrongly(bench):
    graph, operator = start(bench, procedure(), site())
    begin(operator)
    assert operator.wait(lambda: len(operator.heard.session()[1]) >= 60, WHOLE)
    graph.kill("probe")
    graph.start("probe")
    ended(operator)
    assert operator.wait(lambda: len(operator.heard.session()[1]) >= 200, PATIENCE)
    session = live_session(*operator.heard.session())
    form = FORM * np.random.default_rng([SEED, 41]).normal(size=40)
    # the machine is perfect: a touch shows the form of the very point that its row names
    np.testing.assert_allclose(session.readings.displacement, np.tile(form, 5), atol=2e-9)
