# SPDX-License-Identifier: Apache-2.0
"""Nodes that die, start late or start again, and beams that are interrupted, in the middle of a procedure."""

import copy
import re
import signal

import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters

from .conftest import PATIENCE, PROCEDURE, SITE, WHOLE, ask, begin, ended, resumed
from .reference import reference
from .test_measurement import readings, since_first

LONG = copy.deepcopy(PROCEDURE)
LONG["path"]["grid"]["x"]["count"] = LONG["path"]["grid"]["y"]["count"] = 4
TOTAL = 4 * 4 * 4 * 2
SOON = {"resend": 0.2}  # s, so that a command that was lost is soon sent again


def reaches(operator, count):
    assert operator.wait(lambda: len(operator.heard.session()[1]) >= count, WHOLE), operator.procedure


def check(operator):
    ended(operator)
    assert operator.wait(lambda: len(operator.heard.session()[1]) == TOTAL, PATIENCE)
    table = readings(operator)
    assert np.abs(since_first(operator, table["displacement"]) - reference(LONG, SITE)).max() < 1e-9
    assert all(np.diff(table["time"]) > 0)


@pytest.mark.long
def test_a_partner_that_starts_late_and_every_partner_killed_and_started_again(bench):
    # a partner may take long to come back where others keep the machine busy
    graph = bench.graph(procedure=LONG, more={"procedure": {**SOON, "patience": PATIENCE}})
    graph.stop(["instrument"])
    operator = bench.operator(graph)
    assert operator.wait(lambda: operator.procedure.entries.get("waiting_for") == "instrument", PATIENCE)
    operator.call("procedure/start", PATIENCE)
    assert operator.wait(lambda: operator.procedure.entries["state"] == "running", PATIENCE)
    assert operator.wait(lambda: operator.procedure.message == "waiting for instrument", PATIENCE)
    graph.start("instrument")
    for count, name in ((20, "instrument"), (50, "rotary_pointer"), (80, "axis_simulator")):
        reaches(operator, count)
        assert graph.kill(name) == -signal.SIGKILL
        assert operator.wait(lambda: bool(operator.procedure.entries["waiting_for"]), PATIENCE), operator.procedure
        assert operator.procedure.entries["state"] == "running"
        graph.start(name)
    check(operator)
    assert operator.procedure.number("recoveries") >= 1  # the instrument's datum was gone
    assert operator.procedure.number("restarts") == 1  # the axes


@pytest.mark.long
def test_a_partner_that_stays_dead_is_an_error_that_can_be_resumed(bench):
    graph = bench.graph(procedure=LONG, more={"procedure": {**SOON, "patience": 2.0}})
    operator = bench.operator(graph)
    begin(operator)
    resumed(operator, lambda: len(operator.heard.session()[1]) >= 20)
    graph.kill("rotary_pointer")
    resumed(operator, lambda: operator.procedure.message.startswith("no answer from rotary pointer"))
    assert re.fullmatch(r"no answer from rotary pointer for \d+ s", operator.procedure.message)
    assert operator.procedure.entries["state"] == "error"
    graph.start("rotary_pointer")
    resumed(operator, lambda: operator.procedure.entries["state"] == "finished")
    check(operator)


def block(operator, value):
    wanted = ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=value)
    request = SetParameters.Request(parameters=[Parameter(name="beam_blocked", value=wanted)])
    assert ask(operator, SetParameters, "instrument/set_parameters", request).results[0].successful


def test_pause_resume_abort_a_hand_in_the_beam_and_start_again(bench):
    operator = bench.operator(bench.graph(procedure=LONG))
    block(operator, False)  # so that the node knows its client when there is no time to lose
    begin(operator)
    reaches(operator, 30)
    operator.call("procedure/pause", PATIENCE)
    assert operator.wait(lambda: operator.procedure.entries["state"] == "paused", PATIENCE)
    captured = operator.procedure.number("captured")
    assert operator.wait(lambda: len(operator.heard.session()[1]) == captured, PATIENCE)
    operator.wait(lambda: False, 0.3)
    assert operator.procedure.number("captured") == captured == len(operator.heard.session()[1])
    operator.call("procedure/resume", PATIENCE)
    reaches(operator, captured + 20)
    operator.call("procedure/abort", PATIENCE)
    assert operator.wait(lambda: operator.procedure.entries["state"] == "aborted", PATIENCE)
    # the last reading may be heard after the state
    assert operator.wait(lambda: len(operator.heard.session()[1]) == operator.procedure.number("captured"), PATIENCE)
    run = operator.heard.count[0]
    operator.call("procedure/start", PATIENCE)
    assert operator.wait(lambda: operator.heard.count[0] > run, WHOLE)  # those of the last run are forgotten
    reaches(operator, 40)
    block(operator, True)
    assert operator.wait(lambda: operator.procedure.entries["state"] == "error", PATIENCE)
    assert operator.procedure.message == "instrument: the beam is blocked"
    block(operator, False)
    operator.call("procedure/resume", PATIENCE)
    assert operator.wait(lambda: operator.procedure.entries["state"] == "running", PATIENCE)
    check(operator)
    assert {0.0, 1.0} < set(readings(operator)["datum"])
