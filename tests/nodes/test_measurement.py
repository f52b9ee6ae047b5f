# SPDX-License-Identifier: Apache-2.0
"""Graphs beside each other, in real time, and with listeners that end."""

import copy
from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
import yaml

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes import measurement
from machine_tool_calibration.nodes.graph import Graph
from machine_tool_calibration.nodes.measurement import _Listeners, _misspelt

from .conftest import PATIENCE, PROCEDURE, SITE
from .reference import reference


def readings(operator):
    names = list(operator.heard.session()[1][0].names)
    table = np.array([list(message.values) for message in operator.heard.session()[1]])
    return {name: table[:, index] for index, name in enumerate(names)}


def since_first(operator, displacement):
    setups = [message.values[list(message.names).index("setup_index")] for message in operator.heard.session()[1]]
    first = {}
    for setup, value in zip(setups, displacement, strict=True):
        first.setdefault(setup, value)
    return displacement - np.array([first[setup] for setup in setups])


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        ({"model": "rigid_bdy"}, "has no model 'rigid_bdy' .did you mean 'rigid_body'"),
        ({"model": "circle"}, "has no model 'circle'; known are free, rigid_body"),
        ({"effects": ("backlsh_x",)}, "unknown effect 'backlsh_x' .did you mean 'backlash_x'"),
    ],
)
def test_what_cannot_be_identified_is_refused_before_anything_moves(tmp_path, asked, why):
    file = tmp_path / "procedure.yaml"
    file.write_text(yaml.safe_dump(PROCEDURE), encoding="utf-8")
    output = tmp_path / "out"
    with pytest.raises(CalibrationError, match=why):
        measurement.measure(file, measurement.Setting(output=output, **asked))
    assert not output.exists()


def test_an_effect_of_the_users_own_may_be_in_a_file_that_the_parameters_name(tmp_path, monkeypatch):
    """Then the estimator alone knows it: the graph is started."""
    file, parameters = tmp_path / "procedure.yaml", tmp_path / "nodes.yaml"
    file.write_text(yaml.safe_dump(PROCEDURE), encoding="utf-8")
    parameters.write_text("/**/estimator: {ros__parameters: {effects_files: [own.yaml]}}", encoding="utf-8")
    monkeypatch.setattr(measurement, "claimed_domain", MagicMock(side_effect=CalibrationError("it would start")))
    setting = measurement.Setting(output=tmp_path / "out", effects=("settling",), parameters=parameters)
    (tmp_path / "out").mkdir()
    with pytest.raises(CalibrationError, match="it would start"):
        measurement.measure(file, setting)


@pytest.mark.long
def test_two_graphs_in_one_domain(bench, finish):
    other = {**SITE, "machine": {**SITE["machine"], "seed": 78}}
    first = bench.graph(namespace="cell_1")
    second = bench.graph(namespace="cell_2", site=other)
    operators = bench.operator(first), bench.operator(second)
    for operator in operators:
        finish(operator)
    for operator, site in zip(operators, (SITE, other), strict=True):
        table = readings(operator)
        assert len(operator.heard.session()[1]) == 72
        assert np.abs(since_first(operator, table["displacement"]) - reference(PROCEDURE, site)).max() < 1e-12


@pytest.mark.long
def test_real_time_gives_the_same_readings(bench, finish):
    procedure = copy.deepcopy(PROCEDURE)
    procedure["session"]["repeats"] = 1
    procedure["session"]["setups"] = procedure["session"]["setups"][:2]
    # short ways: each takes its time
    procedure["path"]["grid"] |= {"x": {"first": 0.15, "last": 0.2, "count": 2}, "y": [0.15]}
    procedure["motion"]["dwell"] = 0.3
    graph = bench.graph(procedure=procedure, simulated_time=False)
    operator = bench.operator(graph)
    finish(operator)
    displacement = since_first(operator, readings(operator)["displacement"])
    assert np.abs(displacement - reference(procedure, SITE)).max() < 1e-10
    # each reading was taken while the axes stood: later than the move and the averaging take
    assert np.diff(readings(operator)["time"]).min() > 0.2


def test_a_graph_that_is_there_already_is_refused_before_anything_is_started(bench, monkeypatch):
    bench.graph(("axis_simulator",))
    operator = bench.operator()
    assert operator.wait(lambda: operator.has_node("axis_simulator"), PATIENCE)
    started = []
    monkeypatch.setattr(measurement, "Graph", lambda nodes, *_: SimpleNamespace(namespace="", ended=dict, nodes=nodes))
    monkeypatch.setattr(measurement, "_await_ready", lambda *_: started.append(1))
    setting = measurement.Setting(bench.folder / "run", domain=bench.domain)
    file = bench.folder / "procedure1.yaml"
    with pytest.raises(CalibrationError, match=rf"in ROS domain {bench.domain}, with /axis_simulator: both would move"):
        measurement.measure(file, setting)
    assert not started


@pytest.mark.parametrize(
    ("log", "told"),
    [
        ("[INFO] [17.5] [probe]: touching\n", ""),
        ("[WARN] [17.5] [probe]: slow\n[INFO] [18.0] [probe]: touching\n", ": slow"),
        ("probe: no such file\n\n", ": probe: no such file"),
    ],
)
def test_what_a_node_said_last_is_no_innocent_line_of_its_log(tmp_path, log, told):
    graph = Graph({}, tmp_path, 0)
    (tmp_path / "probe.log").write_text(log)
    graph._running["probe"] = SimpleNamespace(poll=lambda: -9, returncode=-9)
    assert graph.ended() == {"probe": f"probe was ended by SIGKILL{told}"}
    graph._running["probe"] = SimpleNamespace(poll=lambda: 1, returncode=1)
    assert graph.ended() == {"probe": f"probe ended with status 1{told}"}


def test_a_misspelt_node_of_a_parameter_file_is_told(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text("/**/instrumnt: {ros__parameters: {a: 1}}\n/cell/estimator: {}\n/**: {}\nrobot_driver: {}\n")
    told = list(_misspelt(file, ["instrument", "estimator", "recorder"]))
    assert told == [f"{file}: no node 'instrumnt' is started (did you mean 'instrument'?)"]
    assert list(_misspelt(None, ["instrument"])) == []


def test_a_misspelt_parameter_of_a_parameter_file_is_told(tmp_path):
    file = tmp_path / "own.yaml"
    given = "averagng: 1.0, averaging: 1.0, use_sim_time: true, qos_overrides: {}, autostart: true"
    file.write_text(f"/**/instrument: {{ros__parameters: {{{given}}}}}\n/**: {{ros__parameters: {{a: 1}}}}\n")
    told = list(_misspelt(file, ["instrument"]))
    assert told == [f"{file}: instrument has no parameter 'averagng' (did you mean 'averaging'?)"]


def test_a_listener_that_ends_is_started_again_and_what_it_missed_is_said(tmp_path):
    why, done = "recorder was ended by SIGKILL", []
    graph = SimpleNamespace(
        ended=lambda: {"recorder": why}, start=lambda name, folder: done.append((name, folder)), kill=done.append
    )
    told: list[str] = []
    listeners, before = _Listeners(graph, tmp_path, told.append), tmp_path / "bag"
    with pytest.raises(CalibrationError, match=rf"^{why}$"):  # nothing is being measured yet
        listeners.watch()
    listeners.client = SimpleNamespace(heard=SimpleNamespace(count=(1, 40)))
    for number in (2, 3, 4):
        listeners.watch()
        assert listeners.bag == tmp_path / f"bag_{number}" and done[-1] == ("recorder", str(listeners.bag))
        assert listeners.remarks[-1].startswith(f"{why} after 40 readings; {listeners.bag} has all readings")
        assert f"`mtcal recover {before}`" in listeners.remarks[-1]
        before = listeners.bag
    listeners.watch()
    assert done[-1] == "recorder" and listeners.remarks[-1] == f"{why}; it is not started again"
    assert told == listeners.remarks
    graph.ended = lambda: {"procedure": "procedure ended"}
    with pytest.raises(CalibrationError, match=r"^procedure ended$"):
        listeners.watch()
