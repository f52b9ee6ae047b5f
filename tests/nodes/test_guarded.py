# SPDX-License-Identifier: Apache-2.0
"""Nodes in this process, without a graph: parameters that cannot be, missing readings, starts that come too early."""

import asyncio
import gc
import threading
import time
import uuid
from types import SimpleNamespace

import pytest
import rclpy
import yaml
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.exceptions import InvalidParameterValueException
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes import measurement
from machine_tool_calibration.nodes.axis_simulator import AxisSimulator
from machine_tool_calibration.nodes.estimator import Estimator
from machine_tool_calibration.nodes.heard import Heard, NodeState
from machine_tool_calibration.nodes.probe import Probe
from machine_tool_calibration.nodes.procedure import ProcedureNode
from machine_tool_calibration.nodes.ros import process
from machine_tool_calibration.nodes.ros.messages import READINGS, Level, dated, status, to_message, values
from machine_tool_calibration.nodes.ros.process import post
from machine_tool_calibration.nodes.ros.services import Reply, _Goal, goal_sentence
from machine_tool_calibration.procedure.events import CaptureFailed

from .conftest import ORIGIN, PATIENCE, PROCEDURE

START = round(ORIGIN * 1e9)


@pytest.fixture
def made(tmp_path):
    """Makes nodes with parameters; all end with the test."""
    nodes = []

    def make(kind, **parameters):
        if kind is ProcedureNode:
            parameters["procedure"] = tmp_path / "procedure.yaml"
            parameters["procedure"].write_text(yaml.safe_dump(PROCEDURE))
        given = [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]
        rclpy.init(args=["--ros-args", *given])
        nodes.append(kind())
        nodes[-1].start()
        return nodes[-1]

    yield make
    for node in nodes:
        node.trigger_shutdown()
        node.destroy_node()
    rclpy.try_shutdown()
    # One that could not start hangs together with its error in a circle, and is seen in the graph until that is broken.
    gc.collect()


def hear(node, topic, message):
    (callback,) = [s.callback for s in node.subscriptions if s.topic_name == f"/{topic}"]
    callback(serialize_message(message))


def shown(node):
    """What a node's next status says."""
    said = []
    node._status._publisher = SimpleNamespace(publish=said.append)
    node._status._said = None
    node._show()
    return said[-1].status[0]


def reading(index, time=None, displacement=0.0, **more):
    place = dict.fromkeys(("repeat", "x", "y", "z", "azimuth"), 0.0)
    columns = {"time": float(index if time is None else time), "setup_index": 0.0, "displacement": displacement}
    columns |= place | more
    message = JointState(name=list(columns), position=list(columns.values()))
    message.header.stamp = to_message(START + round(index * 1e9))
    return message


# --- status and faults


def test_a_status_is_said_again_only_where_something_has_changed(made):
    node = made(Estimator)
    said = []
    node._status._publisher = SimpleNamespace(publish=said.append)
    node._show()
    assert not said
    node.goals.level = Level.ERROR  # the same words and values
    node._show()
    (entry,) = said[-1].status
    assert (entry.level, entry.message) == (b"\x02", "no identification yet")
    node._show()
    assert len(said) == 1


class Tasks:
    """Of an executor what posting needs."""

    def add_node(self, node):
        return True

    def create_task(self, function):
        function()


def test_a_fault_of_posted_work_is_logged_once_with_its_place(made, monkeypatch):
    node, logged = made(Estimator), []
    executor = Tasks()
    node.executor = executor
    monkeypatch.setattr(node, "get_logger", lambda: SimpleNamespace(error=logged.append))

    def work():
        raise ValueError("no such thing")

    post(node, work)
    post(node, work)
    (text,) = logged
    assert text.startswith("work: ValueError: no such thing\n") and "in work" in text


# --- parameters


WRONG = [
    ("model", "rigid", "unknown model 'rigid'; known are "),
    ("effects", ["backlash_q"], "unknown effect 'backlash_q' (did you mean"),
    ("effects", ["backlash_x", "backlash_x"], "the effect 'backlash_x' is named twice"),
    ("effects_files", ["/nowhere.yaml"], "/nowhere.yaml: no such file"),
    ("magnification", float("nan"), "magnification"),
    ("magnification", float("inf"), "magnification"),
]


def test_values_that_cannot_be_are_refused_when_they_are_set(made):
    node = made(Estimator)
    before = {name: node.get_parameter(name).value for name, _, _ in WRONG}
    for name, value, why in WRONG:
        (answer,) = node.set_parameters([Parameter(name, value=value)])
        assert not answer.successful, name
        assert why in answer.reason
    assert {name: node.get_parameter(name).value for name in before} == before
    for name, value in (("model", "rigid_body"), ("effects", ["backlash_x"]), ("model", ""), ("effects", [""])):
        assert node.set_parameters([Parameter(name, value=value)])[0].successful, name


def test_a_model_of_another_method_is_refused_once_the_session_is_known(made):
    node = made(Estimator)
    assert node.set_parameters([Parameter("model", value="angular")])[0].successful
    assert node.set_parameters([Parameter("model", value="")])[0].successful
    hear(node, "session", String(data=yaml.safe_dump({"format": "mtcal-session/1", **PROCEDURE["session"]})))
    assert not node.ignored
    (answer,) = node.set_parameters([Parameter("model", value="angular")])
    assert not answer.successful and answer.reason.endswith("known are free, rigid_body")


@pytest.mark.parametrize(("name", "value"), [("effects", "[no_such]"), ("model", "no_such")])
def test_a_node_does_not_start_with_values_that_cannot_be(made, name, value):
    with pytest.raises(InvalidParameterValueException, match=f"no_such.*: {name}$"):
        made(Estimator, **{name: value})


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"effects": "backlash_y"}, r"^parameter effects is a list: effects:=\[backlash_y\]$"),
        ({"use_sim_time": "maybe"}, "^parameter use_sim_time is 'maybe', neither true nor false$"),
    ],
)
def test_a_word_for_a_list_and_a_clock_that_is_neither_are_refused(made, given, why):
    with pytest.raises(CalibrationError, match=why):
        made(Estimator, **given)


def test_that_another_node_has_the_same_name_is_said_once(made, monkeypatch, capfd):
    node = made(Estimator)
    mine = (node.get_name(), node.get_namespace())
    for there in ([mine], [mine, mine], [mine]):  # as one is that was killed and is started again
        monkeypatch.setattr(node, "get_node_names_and_namespaces", lambda there=there: there)
        node._look_for_namesakes()
    assert "another node is called" not in capfd.readouterr().err
    monkeypatch.setattr(node, "get_node_names_and_namespaces", lambda: [mine, mine])
    for _ in range(6):
        node._look_for_namesakes()
    assert capfd.readouterr().err.count("another node is called /estimator") == 1


def test_nothing_is_identified_from_no_readings(made):
    node = made(Estimator)
    hear(node, "session", String(data=yaml.safe_dump({"format": "mtcal-session/1", **PROCEDURE["session"]})))
    with pytest.raises(CalibrationError, match="no readings yet"):
        node._begin("identifying", lambda request, progress: None)


def test_a_parameter_that_there_is_not_is_said(made, capfd):
    node = made(AxisSimulator, sped=1.0)
    assert not node.has_parameter("sped")
    assert "this node has no parameter 'sped' (did you mean 'speed'?)" in capfd.readouterr().err


def test_a_fault_in_a_timer_or_a_service_is_logged_and_the_node_goes_on(made, capfd):
    node = made(AxisSimulator)

    def stumble(*_):
        raise ZeroDivisionError("an axis without length")

    timer = node.create_timer(1.0, stumble)
    service = node.create_service(Trigger, "walk", stumble)
    for _ in range(3):
        timer.callback()
        answer = asyncio.run(service.callback(Trigger.Request(), Trigger.Response()))
        assert (answer.success, answer.message) == (False, "ZeroDivisionError: an axis without length")
    said = capfd.readouterr().err
    for where in ("stumble", "walk"):
        assert said.count(f"{where}: ZeroDivisionError: an axis without length") == 1
    assert "in stumble" in said


def test_what_the_handler_of_an_event_raises_is_logged_and_the_node_goes_on(made, capfd, monkeypatch):
    node, stop = made(AxisSimulator), threading.Event()
    turns = iter((ZeroDivisionError("no publisher"), None))

    class Executor:
        def add_node(self, node):
            pass

        def shutdown(self):
            pass

        def spin_once(self, timeout_sec):
            raised = next(turns)
            if raised is not None:
                raise raised
            stop.set()

    monkeypatch.setattr(process, "SingleThreadedExecutor", Executor)
    process._spin(node, stop)
    assert "a callback: ZeroDivisionError: no publisher" in capfd.readouterr().err


def test_a_node_that_is_deactivated_leaves_the_graph_and_begins_anew(made):
    node = made(AxisSimulator)
    for parameter in (Parameter("speed", value=0.1), Parameter("use_sim_time", value=True)):
        (answer,) = node.set_parameters([parameter])
        assert not answer.successful and "cannot be set while the node is configured" in answer.reason
    topics = {publisher.topic_name for publisher in node.publishers}
    assert {"/joint_states", "/axes/executed"} <= topics
    epoch = node._motion
    assert node.trigger_deactivate() == node.trigger_cleanup() == TransitionCallbackReturn.SUCCESS
    assert not {"/joint_states", "/axes/executed"} & {publisher.topic_name for publisher in node.publishers}
    assert node.set_parameters([Parameter("speed", value=0.1), Parameter("site", value="/nowhere.yaml")])[0].successful
    assert node.trigger_configure() == TransitionCallbackReturn.FAILURE and node.fault == "/nowhere.yaml: no such file"
    assert node.set_parameters([Parameter("site", value="")])[0].successful
    node.start()
    assert {publisher.topic_name for publisher in node.publishers} == topics
    assert node._motion is not epoch and node.limits["x"].speed == 0.1


# --- readings that are missing


def test_the_estimator_says_which_readings_never_came(made):
    node = made(Estimator)
    assert (values_of(shown(node))["missing"], shown(node).level) == ("0", b"\0")
    for index in (7, 8, 9):
        hear(node, "reading", reading(index, reading_index=float(index)))
    entry = shown(node)
    assert values_of(entry)["missing"] == "7"
    assert entry.message.endswith("; the first 7 of 10 readings are missing")
    assert entry.level == bytes([Level.WARN])
    for index in range(6):
        hear(node, "reading", reading(index, reading_index=float(index)))
    assert shown(node).message.endswith("; 1 of 10 readings are missing")
    hear(node, "reading", reading(6, reading_index=6.0))
    assert values_of(shown(node))["missing"] == "0" and shown(node).level == b"\0"


def test_the_estimator_says_that_no_reading_of_a_publisher_was_heard(made):
    node = made(Estimator)
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def comes_and_goes(*messages):
        total, _ = node._sources
        other = rclpy.create_node("bag")
        publisher = other.create_publisher(JointState, "reading", READINGS)
        for message in messages:
            publisher.publish(message)
        wait(lambda: node._sources == (total + 1, 1) and len(node._received) >= len(messages))
        other.destroy_node()
        wait(lambda: node._sources == (total + 1, 0))
        return shown(node)

    def wait(condition):
        ends = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < ends
            executor.spin_once(timeout_sec=0.1)

    words = "; a publisher of readings came and went, and none of its readings was heard"
    assert shown(node).level == b"\0"
    entry = comes_and_goes()
    assert entry.level == bytes([Level.WARN]) and entry.message.endswith(words)
    entry = comes_and_goes(reading(0, reading_index=0.0))
    assert entry.level == b"\0" and not entry.message.endswith(words)
    assert comes_and_goes().message.endswith(words), "another one"
    node._reset()
    assert shown(node).level == b"\0"
    executor.shutdown()


def test_a_reset_is_counted_and_what_follows_shows_the_gap(made):
    node = made(Estimator)
    for index in range(4):
        hear(node, "reading", reading(index, reading_index=float(index)))
    assert node._reset() == "4 readings forgotten"
    hear(node, "reading", reading(4, reading_index=4.0))
    assert {key: values_of(shown(node))[key] for key in ("readings", "missing", "resets")} == {
        "readings": "1",
        "missing": "4",
        "resets": "1",
    }


def test_readings_of_the_next_session_are_held_against_its_description(made):
    node = made(Estimator)
    for first in (0, 1000):  # s at which each begins
        hear(node, "session", String(data=yaml.safe_dump({"format": "mtcal-session/1", **PROCEDURE["session"]})))
        node._found = ("backlash_x",)
        for index in range(3):
            hear(node, "reading", reading(first + index, time=index))
        hear(node, "reading", reading(first + 3, time=3, setup_index=9.0))  # of four setups
        assert values_of(shown(node))["readings"] == "3"
    assert node.ignored == {"reading": 2} and not node._found  # of other readings
    hear(node, "reading", reading(2000, time=0))  # a session that nothing describes
    hear(node, "reading", reading(2001, time=1, setup_index=9.0))
    assert values_of(shown(node))["readings"] == "2"


def test_a_calculation_whose_outcome_cannot_be_published_has_ended_all_the_same(made):
    node = made(Estimator)
    goal = node.goals._present = _Goal("identify", uuid.uuid4(), 0, "identifying", 0.0)
    node.goals._end(goal, object(), lambda outcome: 1 / 0)
    assert goal.status == GoalStatus.STATUS_ABORTED and not node.goals.doing
    assert node.goals.last == "unexpected ZeroDivisionError: division by zero"


def test_what_was_calculated_of_an_earlier_session_is_not_told_of_the_next(made):
    node = made(Estimator)

    def calculated(words):
        goal = node.goals._present = _Goal("identify", uuid.uuid4(), 0, "identifying", 0.0)
        yield
        node.goals._end(goal, object(), lambda outcome: (words, {}))
        yield shown(node).message

    hear(node, "reading", reading(0, time=0))
    assert list(calculated("identified of the first"))[-1] == "identified of the first"
    during = calculated("diagnosed of the first")
    next(during)
    hear(node, "reading", reading(1000, time=0))
    assert next(during) == "no identification yet" and values_of(shown(node))["readings"] == "1"
    assert list(calculated("identified of the second"))[-1] == "identified of the second"
    assert shown(node).level == b"\0"
    node.goals.level = Level.ERROR
    node._reset()
    assert (shown(node).message, shown(node).level) == ("no identification yet", b"\0")


def test_a_stray_reading_does_not_cost_those_that_are_there(made):
    node = made(Estimator)
    for index in range(4):
        hear(node, "reading", reading(index, reading_index=float(index)))
    for stray in (
        reading(9, time=1e14),
        reading(9, time=float("inf")),
        reading(9, time=1e308),
        reading(9, reading_index=-1.0),
        reading(9, reading_index=0.5),
        JointState(name=["time", "displacement"], position=[9.0]),
        reading(9, setup_index=0.5),
        JointState(name=["setup_index"], position=[1e9]),
        JointState(name=["displacement"], position=[1e-6]),
    ):
        hear(node, "reading", stray)
    assert values_of(shown(node))["readings"] == "4"
    assert node.ignored == {"reading": 9}


def values_of(entry):
    return values(DiagnosticArray(status=[entry]))


# --- the procedure


@pytest.mark.parametrize("aborted", [False, True])
def test_a_procedure_waits_for_the_first_clock(made, aborted):
    node = made(ProcedureNode, use_sim_time="true")
    assert "/clock" in values_of(shown(node))["waiting_for"]
    assert node._start() == "it starts with the first /clock"
    node._tick()
    assert values_of(shown(node))["state"] == "idle"
    if aborted:
        assert node._abort() == "it does not start"
    hear(node, "clock", Clock(clock=to_message(START)))
    node._tick()
    assert values_of(shown(node))["state"] == ("idle" if aborted else "running")
    if not aborted:
        assert node.sequencer.origin == START
        node._abort()


def test_services_that_move_axes_can_be_refused(made):
    node = made(ProcedureNode, services_move_axes="false")
    for handler in (node._start, node._resume):
        with pytest.raises(CalibrationError, match="services_move_axes is false"):
            handler()
    # not by the same way as the start
    (answer,) = node.set_parameters([Parameter("services_move_axes", value=True)])
    assert not answer.successful


def test_a_touch_can_be_refused(made):
    node = made(Probe, services_move_axes="false")
    answer = Reply()
    node._requested(answer)
    response = asyncio.run(answer.into(Trigger.Response()))
    assert not response.success and "services_move_axes is false" in response.message


@pytest.mark.parametrize("first", ["answer", "outcome"])
def test_a_reading_counts_whichever_of_answer_and_outcome_comes_first(made, first):
    node, events = made(ProcedureNode), []
    node._hear = events.append

    def outcome(goal, displacement):
        found = {"datum": "d-1", "start": START, "end": START + 9, "displacement": displacement}
        said = status("capture", Level.OK, "", found, goal)
        hear(node, "instrument/outcome", dated(DiagnosticArray(status=[said]), START + 5))

    def answer(token, message, success=True):
        node._answered(token, Trigger.Response(success=success, message=message))

    own, of_another = "a" * 32, "b" * 32
    ways = [lambda: answer(7, goal_sentence(own, "done")), lambda: outcome(own, 0.25)]
    outcome(of_another, 0.5)  # whom nobody here has asked
    for way in ways if first == "answer" else reversed(ways):
        assert not events
        way()
    (event,) = events
    assert (event.token, event.displacement, event.stamp) == (7, 0.25, START + 5)
    answer(8, "the node has failed", success=False)
    assert events[1:] == [CaptureFailed(8, "other", "the node has failed")]


# --- mtcal run


class Gone:
    """A client that hears no procedure any more."""

    def __init__(self, message="measuring", **entries):
        self.state, self.heard = NodeState("", "", message=message, entries=entries), Heard()

    @property
    def procedure(self):
        return self.state

    estimator = procedure

    def call(self, service, timeout):
        return ""

    def has_node(self, name):
        return False

    def wait(self, until, timeout):
        while not until():
            pass
        return True


def test_a_run_whose_procedure_has_gone_ends(monkeypatch):
    monkeypatch.setattr(measurement, "_GONE", 0.01)
    with pytest.raises(CalibrationError, match="the procedure has ended in the middle"):
        measurement._run(Gone(state="running", captured="40"), 128, lambda text, done, total: None)


def test_a_run_whose_procedure_was_started_anew_says_so_at_once():
    operator, states = Gone(), iter(("idle", "running", "idle"))
    operator.has_node = lambda name: True

    def wait(until, timeout):
        for state in states:
            operator.state = NodeState("", "", entries={"state": state})
            assert not until()

    operator.wait = wait
    with pytest.raises(CalibrationError, match=r"started anew in the middle .*: run the procedure again"):
        measurement._run(operator, 128, lambda text, done, total: None)


def test_a_count_that_is_none_is_zero():
    status = NodeState("procedure", "procedure", entries={"captured": "soon", "total": "9" * 400, "resent": "7"})
    assert [status.number(name) for name in ("captured", "total", "resent", "stale")] == [0, 0, 7, 0]
