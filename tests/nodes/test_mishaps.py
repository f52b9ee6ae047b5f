"""Nodes that die, start late or start again, and beams that are interrupted, in the middle of a procedure."""

import copy
import signal

import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters

from .conftest import PROCEDURE, SITE, begin
from .reference import reference
from .test_measurement import readings, since_first

LONG = copy.deepcopy(PROCEDURE)
LONG["path"]["grid"]["x"]["count"] = LONG["path"]["grid"]["y"]["count"] = 9
TOTAL = 9 * 9 * 4 * 2


def reaches(operator, count):
    assert operator.wait(lambda: len(operator.readings) >= count, 60.0), operator.procedure


def check(operator):
    assert operator.wait(lambda: operator.procedure.entries["state"] != "running", 60.0), operator.procedure
    assert operator.procedure.entries["state"] == "finished", operator.procedure
    assert operator.wait(lambda: len(operator.readings) == TOTAL, 10.0)
    table = readings(operator)
    assert np.abs(since_first(operator, table["displacement"]) - reference(LONG, SITE)).max() < 1e-9
    assert all(np.diff(table["time"]) > 0)


@pytest.mark.timeout(180)
def test_every_partner_killed_and_started_again(bench):
    graph = bench.graph(procedure=LONG)
    operator = bench.operator(graph)
    begin(operator)
    for count, name in ((60, "instrument"), (200, "rotary_pointer"), (350, "axis_simulator")):
        reaches(operator, count)
        assert graph.kill(name) == -signal.SIGKILL
        assert operator.wait(lambda: bool(operator.procedure.entries["waiting_for"]), 10.0), operator.procedure
        assert operator.procedure.entries["state"] == "running"
        graph.start(name)
    check(operator)
    assert operator.procedure.number("recoveries") >= 1  # the instrument's datum was gone
    assert operator.procedure.number("restarts") == 1  # the axes


@pytest.mark.timeout(120)
def test_a_partner_that_stays_dead_is_an_error_that_can_be_resumed(bench):
    graph = bench.graph(procedure=LONG, more={"procedure": {"patience": 2.0}})
    operator = bench.operator(graph)
    begin(operator)
    reaches(operator, 30)
    graph.kill("rotary_pointer")
    assert operator.wait(lambda: operator.procedure.entries["state"] == "error", 20.0)
    assert operator.procedure.message == "no answer from rotary pointer for 2 s"
    graph.start("rotary_pointer")
    operator.wait(lambda: False, 3.0)
    operator.call("procedure/resume", 5.0)
    assert operator.wait(lambda: operator.procedure.entries["state"] == "running", 5.0)
    check(operator)


@pytest.mark.timeout(120)
def test_a_partner_that_starts_late_is_waited_for(bench):
    graph = bench.graph(procedure=LONG)
    graph.stop(["instrument"])
    operator = bench.operator(graph)
    assert operator.wait(lambda: operator.procedure.entries.get("waiting_for") == "instrument", 30.0)
    operator.call("procedure/start", 10.0)
    assert operator.wait(lambda: operator.procedure.entries["state"] == "running", 10.0)
    assert operator.wait(lambda: operator.procedure.message == "waiting for instrument", 10.0)
    graph.start("instrument")
    check(operator)


@pytest.mark.timeout(120)
def test_a_hand_in_the_beam(bench):
    graph = bench.graph(procedure=LONG)
    operator = bench.operator(graph)
    begin(operator)
    reaches(operator, 100)

    def block(value):
        client = operator._node.create_client(SetParameters, "instrument/set_parameters")
        assert operator.wait(client.service_is_ready, 10.0)
        wanted = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=value)
        future = client.call_async(SetParameters.Request(parameters=[Parameter(name="beam_blocked", value=wanted)]))
        assert operator.wait(future.done, 10.0)
        assert future.result().results[0].successful

    block(True)
    assert operator.wait(lambda: operator.procedure.entries["state"] == "error", 20.0)
    assert operator.procedure.message == "instrument: the beam is blocked"
    block(False)
    operator.call("procedure/resume", 5.0)
    assert operator.wait(lambda: operator.procedure.entries["state"] == "running", 5.0)
    check(operator)
    assert {0.0, 1.0} < set(readings(operator)["datum"])


@pytest.mark.timeout(120)
def test_pause_resume_abort_and_start_again(bench, finish):
    graph = bench.graph(procedure=LONG)
    operator = bench.operator(graph)
    begin(operator)
    reaches(operator, 50)
    operator.call("procedure/pause", 5.0)
    assert operator.wait(lambda: operator.procedure.entries["state"] == "paused", 5.0)
    captured = operator.procedure.number("captured")
    operator.wait(lambda: False, 1.0)
    assert operator.procedure.number("captured") == captured == len(operator.readings)
    operator.call("procedure/resume", 5.0)
    reaches(operator, captured + 50)
    operator.call("procedure/abort", 5.0)
    assert operator.wait(lambda: operator.procedure.entries["state"] == "aborted", 5.0)
    operator.readings.clear()
    operator.call("procedure/start", 5.0)
    assert operator.wait(lambda: operator.procedure.entries["state"] == "running", 5.0)
    check(operator)
