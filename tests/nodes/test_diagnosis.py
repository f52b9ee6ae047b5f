# SPDX-License-Identifier: Apache-2.0
"""The estimator says what the model lacks, adds it, and goes on hearing readings meanwhile."""

import json
import signal

import pytest
from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from diagnostic_msgs.msg import DiagnosticArray
from diagnostic_msgs.srv import AddDiagnostics
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from std_msgs.msg import String
from std_srvs.srv import Trigger

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.ros.messages import LATCHED
from machine_tool_calibration.recording.open import open_measurement
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation.simulate import simulate
from machine_tool_calibration.simulation.spec import FlawSpec, SimulationSpec
from machine_tool_calibration.simulation.tracking_run import TrackingPlan

from .conftest import PATIENCE, ask, feed

GRID = (0.0, 0.1, 0.2, 0.3, 0.4)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A session of a machine whose Y axis has backlash."""
    plan = TrackingPlan(dimension=2, x=GRID, y=GRID)
    spec = SimulationSpec(plan=plan, effects=(FlawSpec(id="backlash_y", size=2e-6),), seed=4)
    made = tmp_path_factory.mktemp("backlash") / "session"
    write_session(simulate(spec).session, made)
    return made


@pytest.fixture
def printed(capfd):
    """What the command line prints, as a document."""

    def document(*words):
        assert run([*map(str, words), "--json"]) == 0
        return json.loads(capfd.readouterr().out)

    return document


class Heard:
    """The newest message of each latched topic."""

    def __init__(self, operator, **topics):
        self.operator, self.messages = operator, {}
        for name, kind in topics.items():
            operator.node.create_subscription(kind, name.replace("__", "/"), self._keep(name), LATCHED)

    def _keep(self, name):
        return lambda message: self.messages.__setitem__(name, message)

    def __getitem__(self, name):
        assert self.operator.wait(lambda: name in self.messages, PATIENCE), name
        return self.messages[name]


def entries(status):
    return {entry.key: entry.value for entry in status.values}


@pytest.mark.long
def test_the_loop_live_gives_the_documents_of_the_command_line_to_the_last_bit(bench, folder, printed):
    operator = bench.operator(bench.graph(("estimator",), simulated_time=False))
    feed(operator, open_measurement(folder))
    names = {"diagnosis": DiagnosticArray, "diagnosis__result": String, "comparison__result": String}
    names["estimator__status"] = DiagnosticArray

    compared = operator.outcome("estimator/compare", PATIENCE)
    assert float(compared["reduced_chi_square"]) > 2.0
    assert operator.heard.outcome("estimator").message.startswith("compared: The readings scatter")
    diagnosed = operator.outcome("estimator/diagnose", PATIENCE)
    assert diagnosed["verdict"] == "missing_effect" and diagnosed["accepted"] == "backlash_y"
    assert float(diagnosed["rms_after"]) < 0.5 * float(diagnosed["rms_before"])
    heard = Heard(operator, **names)  # latched: they come after the fact
    assert json.loads(heard["comparison__result"].data) == printed("compare", folder)
    document = json.loads(heard["diagnosis__result"].data)
    assert document == printed("diagnose", folder)

    verdict, first, *others = heard["diagnosis"].status
    assert (verdict.name, verdict.level) == ("verdict", b"\x01")
    assert verdict.message.startswith("The model lacks backlash of Y (backlash_y).")
    assert entries(verdict)["accepted"] == "backlash_y"
    assert (first.name, first.level) == ("backlash_y", b"\x01") and first.message.startswith("backlash of Y: b = ")
    (parameter,) = document["candidates"][0]["parameters"]
    told = entries(first)
    assert float(told["backlash_y.b"]) == parameter["value"] == pytest.approx(2e-6, abs=2e-7)
    assert float(told["backlash_y.b standard_uncertainty"]) == parameter["standard_uncertainty"]
    assert told["backlash_y.b unit"] == "m" and told["accepted"] == "True" and told["rank"] == "1"
    assert [status.name for status in others] == [entry["effect"] for entry in document["candidates"][1:]]
    assert {status.level for status in others} == {b"\x00"}

    improved = operator.outcome("estimator/improve", PATIENCE)
    assert improved["effects"] == "backlash_y"
    assert float(improved["rms_after"]) < 0.5 * float(improved["rms_before"])
    assert operator.wait(lambda: "the residual falls" in heard["estimator__status"].status[0].message, PATIENCE)
    assert operator.wait(lambda: bool(operator.heard.published.document), PATIENCE)
    way = json.loads(Heard(operator, improvement__result=String)["improvement__result"].data)
    assert way == printed("improve", folder, "--no-history", "-o", bench.folder / "improve")
    assert [step["effects"] for step in way["steps"]] == [[], ["backlash_y"]]
    assert json.loads(operator.heard.published.document) == way["result"]
    # the effect stays in the model
    found = ask(operator, GetParameters, "estimator/get_parameters", GetParameters.Request(names=["effects"]))
    assert list(parameter_value_to_python(found.values[0])) == ["backlash_y"]
    again = operator.outcome("estimator/diagnose", PATIENCE)
    assert again["verdict"] == "adequate" and again["accepted"] == ""


def waves(bench, count):
    """Parameters of an estimator that has so many effects more to look for."""
    effects = [
        {
            "id": f"wave_{k}",
            "enters": "xy"[k % 2],
            "formula": f"a * sin(x / w + {0.37 * k:.2f}) * cos(y / w - {0.73 * k:.2f})",
            "coefficients": {"a": {"unit": "m", "low": -1e-5, "high": 1e-5}},
            "shapes": {"w": {"unit": "m", "low": 0.01, "high": 1.0}},
        }
        for k in range(count)
    ]
    return {"estimator": {"effects_files": [bench.write("waves.yaml", {"effects": effects})]}}


@pytest.mark.long
def test_a_second_request_is_refused_readings_go_on_and_a_signal_ends_it(bench, folder):
    # so many effects that one step takes longer than all that is asked of the node meanwhile
    graph = bench.graph(("estimator",), simulated_time=False, more=waves(bench, 500))
    operator = bench.operator(graph)
    session = open_measurement(folder)
    feed(operator, session)
    client = operator.node.create_client(Trigger, "estimator/diagnose")
    assert operator.wait(client.service_is_ready, PATIENCE)
    client.call_async(Trigger.Request())
    assert operator.wait(lambda: operator.heard.said("estimator").entries["busy"] == "True", PATIENCE)
    with pytest.raises(CalibrationError, match=r"busy: diagnosing from 200 readings \(\d+ s so far\); ask again"):
        operator.call("estimator/identify", PATIENCE)
    assert operator.wait(
        lambda: "effects, alone and together" in operator.heard.said("estimator").entries["step"], PATIENCE
    )
    feed(operator, session, start=3 * 10**18)  # another session, while it calculates
    assert operator.heard.said("estimator").entries["busy"] == "True"
    assert graph.ends("estimator", signal.SIGTERM)
    operator.wait(lambda: False, 0.1)  # what it has sent
    assert not operator.heard.outcome("estimator").message, "it ends in the middle of its work"


@pytest.mark.long
def test_effects_of_the_users_own_and_what_is_wrong(bench, folder):
    operator = bench.operator(bench.graph(("estimator",), simulated_time=False))
    with pytest.raises(CalibrationError, match="no session has been described yet"):
        operator.call("estimator/diagnose", PATIENCE)
    feed(operator, open_measurement(folder))
    own = bench.write(
        "own.yaml",
        {
            "effects": [
                {
                    "id": "my_reversal",
                    "title": "reversal of Y",
                    "enters": "y",
                    "formula": "-b * dir_y",
                    "coefficients": {"b": {"unit": "m", "low": -1e-4, "high": 1e-4}},
                }
            ]
        },
    )

    def put(name, kind, value):
        request = SetParameters.Request(parameters=[Parameter(name, kind, value).to_parameter_msg()])
        return ask(operator, SetParameters, "estimator/set_parameters", request).results[0].successful

    assert put("effects_files", Parameter.Type.STRING_ARRAY, [own])
    assert put("effects", Parameter.Type.STRING_ARRAY, ["my_reversal"])
    assert float(operator.outcome("estimator/identify", PATIENCE)["reduced_chi_square"]) < 1.5
    # refused at once, and what was set before stays
    assert not put("effects", Parameter.Type.STRING_ARRAY, ["no_such"])
    assert not put("effects_files", Parameter.Type.STRING_ARRAY, ["/nowhere.yaml"])
    assert not put("effects_files", Parameter.Type.STRING_ARRAY, [""])  # an effect in use comes from there
    assert float(operator.outcome("estimator/compare", PATIENCE)["reduced_chi_square"]) < 1.5


@pytest.mark.long
def test_a_calculation_is_cancelled_an_effect_is_added_by_a_service_and_many_requests_are_answered(bench, folder):
    # more effects than there are, so that it is not done before it is cancelled
    operator = bench.operator(bench.graph(("estimator",), simulated_time=False, more=waves(bench, 50)))
    ask(operator, Trigger, "estimator/reset", Trigger.Request())  # then it knows its client
    client = operator.client("estimator/reset")
    asked = [client.call_async(Trigger.Request()) for _ in range(200)]
    assert operator.wait(lambda: all(one.done() for one in asked), PATIENCE), "a usual queue holds 10"
    feed(operator, open_measurement(folder))

    def cancel(goal):
        request = CancelGoal.Request()
        request.goal_info.goal_id.uuid = list(bytes.fromhex(goal)) if goal else [0] * 16
        return ask(operator, CancelGoal, "estimator/cancel", request)

    assert not cancel("").goals_canceling, "nothing is under way"
    said = operator.call("estimator/diagnose", PATIENCE)
    goal = said.removeprefix("goal ").partition(":")[0]
    assert cancel("f" * 32).return_code == CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID
    (cancelled,) = cancel(goal).goals_canceling
    assert bytes(cancelled.goal_id.uuid).hex() == goal
    assert operator.wait(lambda: operator.heard.outcome("estimator").device == goal, PATIENCE)
    ended = operator.heard.outcome("estimator")
    assert (ended.level, ended.message) == (1, "cancelled: diagnosing from 200 readings")
    (last,) = Heard(operator, estimator__goals=GoalStatusArray)["estimator__goals"].status_list
    assert last.status == GoalStatus.STATUS_CANCELED
    assert cancel(goal).return_code == CancelGoal.Response.ERROR_GOAL_TERMINATED

    def add(name):
        return ask(operator, AddDiagnostics, "estimator/add_effect", AddDiagnostics.Request(load_namespace=name))

    assert not add("").success and "no effect is named, and none has been found" in add("").message
    assert not add("no_such").success
    assert add("backlash_y").message == "effects in the model: backlash_y"
    assert float(operator.outcome("estimator/identify", PATIENCE)["reduced_chi_square"]) < 1.5
