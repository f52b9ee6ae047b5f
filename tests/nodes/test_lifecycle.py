# SPDX-License-Identifier: Apache-2.0
"""Managed nodes: a lifecycle manager takes them up and down again, and a person does by `ros2 lifecycle set`."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState

from machine_tool_calibration.recording.reader import BagReader

from .conftest import PATIENCE, PROCEDURE, WHOLE, Bench, ask, begin, collected, ended

MANAGER = Path(__file__).parents[2] / "examples" / "lifecycle_manager.py"
NODES = ("recorder", "axis_simulator", "rotary_pointer", "instrument", "procedure")
# Nobody waits for its end.
ENDLESS = {**PROCEDURE, "session": {**PROCEDURE["session"], "repeats": 100}}
BY_HAND = {"autostart": False}


@pytest.mark.long
def test_a_manager_takes_a_measuring_graph_up_and_down_and_ends_it(bench: Bench) -> None:
    graph = bench.graph(NODES, procedure=ENDLESS, more=dict.fromkeys(NODES, BY_HAND))
    operator = bench.operator(graph)
    said = bench.folder / "manager.log"
    with said.open("w") as log:
        manager = subprocess.Popen([sys.executable, MANAGER, "--shutdown", *NODES], stdout=log, stderr=log)
    try:
        begin(operator)
        assert operator.wait(lambda: operator.heard.count[1] >= 20, WHOLE)
        manager.send_signal(signal.SIGINT)
        assert operator.wait(lambda: manager.poll() is not None, PATIENCE)
    finally:
        manager.kill()
    up = [f"{name}: {state} -> done" for name in NODES for state in ("unconfigured", "inactive")]
    down = [f"{name}: {state} -> done" for name in NODES[::-1] for state in ("active", "inactive", "unconfigured")]
    assert said.read_text().splitlines() == up + down
    assert manager.returncode == 0
    assert operator.wait(lambda: len(graph.ended()) == len(NODES), PATIENCE), graph.ended()
    assert all(" ended with status 0" in why for why in graph.ended().values()), graph.ended()
    # the procedure was measuring: it has stopped the axes, and every reading until then is in a whole recording
    bag = BagReader(bench.folder / "bag1")
    *_, last = bag.messages(["/procedure/status"])
    assert {entry.key: entry.value for entry in bag.decode(last).status[0].values}["state"] == "aborted"
    assert operator.heard.count[1] <= bag.topics["/reading"].messages


def set_state(operator, node: str, label: str) -> bool:
    """What `ros2 lifecycle set /<node> <label>` calls, though it may be none, and whether it tells of success."""
    found = ask(
        operator, GetAvailableTransitions, f"{node}/get_available_transitions", GetAvailableTransitions.Request()
    )
    numbers = {entry.transition.label: entry.transition.id for entry in found.available_transitions}
    wanted = Transition(id=numbers.get(label, getattr(Transition, f"TRANSITION_{label.upper()}", 99)))
    return ask(operator, ChangeState, f"{node}/change_state", ChangeState.Request(transition=wanted)).success


def state(operator, node: str) -> str:
    return ask(operator, GetState, f"{node}/get_state", GetState.Request()).current_state.label


@pytest.mark.long
def test_a_node_is_set_by_hand(bench: Bench) -> None:
    graph = bench.graph(("axis_simulator", "rotary_pointer", "instrument", "procedure", "estimator"),
                        more={"estimator": BY_HAND})  # fmt: skip
    operator = bench.operator(graph)
    begin(operator)
    ended(operator)
    assert state(operator, "estimator") == "unconfigured"
    assert not set_state(operator, "estimator", "activate")  # it is not configured
    assert set_state(operator, "estimator", "configure") and state(operator, "estimator") == "inactive"
    assert "estimator/identify" not in operator.services("estimator")
    for _ in range(2):  # whoever is activated again begins anew, and gets every latched reading
        assert set_state(operator, "estimator", "activate") and state(operator, "estimator") == "active"
        collected(operator, 72)
        assert not set_state(operator, "estimator", "cleanup")
        assert set_state(operator, "estimator", "deactivate")
        assert operator.wait(lambda: "estimator/identify" not in operator.services("estimator"), PATIENCE)
    assert set_state(operator, "estimator", "cleanup") and state(operator, "estimator") == "unconfigured"
    assert set_state(operator, "estimator", "shutdown")
    assert operator.wait(lambda: "estimator" in graph.ended(), PATIENCE)
    assert graph.ended()["estimator"].startswith("estimator ended with status 0")


@pytest.mark.long
def test_a_recorder_that_is_taken_down_and_up_begins_another_bag_and_says_why_it_cannot(bench: Bench) -> None:
    bench.graph(("recorder",), simulated_time=False)
    operator = bench.operator()
    for _ in range(2):
        assert set_state(operator, "recorder", "deactivate")
        assert set_state(operator, "recorder", "activate")
    assert sorted(path.name for path in bench.folder.glob("bag1*")) == ["bag1", "bag1_2", "bag1_3"]
    assert set_state(operator, "recorder", "deactivate")
    (bench.folder / "bag1_4").write_text("something else")
    assert not set_state(operator, "recorder", "activate")
    (log,) = bench.folder.glob("log*/recorder.log")
    assert "not activated: " in log.read_text() and "bag1_4" in log.read_text()


@pytest.mark.long
def test_a_transition_that_cannot_be_made_says_why_and_leaves_the_node_where_it_was(bench: Bench) -> None:
    bench.graph(("procedure",), more={"procedure": {**BY_HAND, "procedure": "/no/such/file.yaml"}})
    operator = bench.operator()
    assert not set_state(operator, "procedure", "configure")
    assert state(operator, "procedure") == "unconfigured"
    (log,) = bench.folder.glob("log*/procedure.log")
    assert "not configured: /no/such/file.yaml: no such file" in log.read_text()
