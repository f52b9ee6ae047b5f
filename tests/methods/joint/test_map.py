# SPDX-License-Identifier: Apache-2.0
"""One map from several sessions: better than each alone, and with the right uncertainty."""

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FitRequest, joint_models
from machine_tool_calibration.methods.identify import JointResult, identify, identify_sessions
from machine_tool_calibration.methods.joint.map import _rotary
from machine_tool_calibration.methods.joint.model import _translated, _translation, _union
from machine_tool_calibration.model.model import Kind, Parameter, motion_value
from machine_tool_calibration.model.rigid_body import MachineTable, map_field
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import FlawSpec
from machine_tool_calibration.simulation.simulate import Simulated, simulate
from machine_tool_calibration.simulation.spec import SimulationSpec

from ... import plates


def _errors(result: JointResult, simulated: Simulated) -> np.ndarray:
    """Map against the truth, without what all readings leave open."""
    points, tables = result.error_map.points, result.common.tables
    field = map_field(tables, points).reshape(-1, 3 * len(points))
    open_ = field.T @ np.array([result.common.fixed[label] for table in tables for label in table.labels])
    error = (result.error_map.error - simulated.truth.machine.position_error(points)).ravel()
    left: np.ndarray = (error - open_ @ np.linalg.lstsq(open_, error, rcond=1e-6)[0]).reshape(-1, 3)
    return left


@pytest.mark.long
def test_normalised_errors_and_chi_square(several: SimpleNamespace, many: Any) -> None:
    normalised, chi = [], []
    some = many.part(0.4)
    for seed in range(some.count):
        simulated = [several.measured(name, seed) for name in ("tracker", "run", "grid")]
        result = identify_sessions(FitRequest(tuple(s.session for s in simulated), ("tracker", "run", "grid")))
        error, uncertainty = _errors(result, simulated[0]), result.error_map.uncertainty
        normalised.append(np.mean((error / uncertainty)[uncertainty > 1e-12] ** 2))
        chi.append(result.fit.reduced_chi_square)
    assert np.mean(normalised) == pytest.approx(1.0, abs=some.off(0.035))
    assert np.mean(chi) == pytest.approx(1.0, abs=some.off(0.007))


def test_nodes_that_are_no_whole_nanometres(several: SimpleNamespace) -> None:
    """A point that rounding puts beside its node has some of the next one: no open direction, which has none of it."""
    nodes = several.nodes / 1.2
    spec = several.machine(1)
    spec["motions"] = {name: own | {"nodes": tuple(nodes)} for name, own in spec["motions"].items()}
    run = plates.session(
        {"x": nodes, "y": 0 * nodes, "z": 0 * nodes,
         "displacement": np.interp(nodes, nodes, spec["motions"]["EXX"]["values"])},
        2e-7, "offset", ("EXX",),
    )  # fmt: skip
    plan = several.PLANS["tracker"] | {"chain": several.CHAIN} | dict.fromkeys("xyz", tuple(nodes))
    tracker = simulate(SimulationSpec.model_validate({"seed": 1, "plan": plan, "machine": spec}))
    result = identify_sessions(FitRequest((tracker.session, run), ("tracker", "run")))
    error, uncertainty = _errors(result, tracker), result.error_map.uncertainty
    assert np.mean((error / uncertainty)[uncertainty > 1e-12] ** 2) < 1.3


@pytest.mark.long
def test_together_is_better_than_alone(several: SimpleNamespace) -> None:
    tracker, run = several.measured("tracker", 1), several.measured("run", 1)
    alone = identify(tracker.session, model="rigid_body")
    both = identify_sessions(FitRequest((tracker.session, run.session), ("tracker", "run")))
    table = both.error_map.content["tables"]["EXX"]
    own = {p.name: p.standard_uncertainty for p in alone.parameters}
    # The run by ISO 230-2 reads EXX from zero to each position directly.
    assert table["value_u"][-1] < 0.9 * own["EXX(0.4)"]
    assert {p.name for p in both.parameters} >= {"tracker/A.dead_path", "EXX(0.4)", "EYX(0.4)"}
    json.dumps(both.document(), allow_nan=False)


@pytest.mark.long
def test_step_diagonal_takes_angular_errors_from_a_tracker(several: SimpleNamespace) -> None:
    simulated = [several.measured(name, 2) for name in ("tracker", "diagonals")]
    result = identify_sessions(FitRequest(tuple(s.session for s in simulated), ("tracker", "diagonals")))
    assert result.fit.reduced_chi_square < 1.1
    assert not result.agreement.contradictions
    assert not result.not_determined
    tracker, diagonals = ({term.name for term in model.terms} for model in result.common.models)
    # All are the machine's. EAX moves the mirror's centre, which a tracker sees; ECX only turns the mirror.
    assert "EAX" in tracker and "ECX" not in tracker
    assert {"EAX", "ECX"} <= diagonals and not any(name.startswith("angle.") for name in diagonals)


def test_nodes_of_all_sessions_in_one_table(several: SimpleNamespace) -> None:
    simulated = [several.measured(name, 3) for name in ("grid", "diagonals")]
    result = identify_sessions(FitRequest(tuple(s.session for s in simulated), ("grid", "diagonals")))
    (table,) = (table for table in result.common.tables if table.name == "EXX")
    np.testing.assert_allclose(table.nodes, np.union1d(np.round(several.nodes, 9), np.round(np.arange(11) * 0.04, 9)))


def test_a_condition_on_a_table_says_the_same_of_one_with_more_nodes(several: SimpleNamespace) -> None:
    """Of every motion that is a straight line between the nodes of the finer table; what is not a table stays."""
    rng = np.random.default_rng(3)
    chain = several.measured("grid", 0).session.description.machine.kinematics
    own = MachineTable(chain, "EXX", np.array([0.0, 0.1, 0.4]))
    finer = MachineTable(chain, "EXX", np.array([0.0, 0.05, 0.2, 0.3, 0.4]))
    square = MachineTable(chain, "C0Y")
    weights = dict(zip((*own.labels, "C0Y", "A.dead_path"), rng.normal(size=5).tolist(), strict=True))
    restated = _translated(weights, _translation((own, square), (finer, square)))
    motion = rng.normal(size=5)
    values = dict(
        zip((*own.labels, "C0Y", "A.dead_path"), [*np.interp(own.nodes, finer.nodes, motion), 0.7, -0.2], strict=True)
    )
    on_finer = dict(zip((*finer.labels, "C0Y", "A.dead_path"), [*motion, 0.7, -0.2], strict=True))
    assert sum(w * on_finer[name] for name, w in restated.items()) == pytest.approx(
        sum(w * values[name] for name, w in weights.items())
    )
    # nothing of a table that is not there any more, nor of a sum that cancels
    assert _translated(weights, _translation((own, square), ())) == {"A.dead_path": weights["A.dead_path"]}
    assert _translated({"one": 1.0, "other": -1.0}, {"one": {"x": 1.0}, "other": {"x": 1.0}}) == {}


def test_tables_of_a_rotary_axis_are_the_machines_motions_about_it() -> None:
    """No linear axis, no squareness, nothing of one session alone."""
    square = Parameter("A0C", "rad", shared=True, kind=Kind.SQUARENESS, owner="A0C")
    own = motion_value("EBC", 0.5, "rad", shared=False)
    every = (motion_value("EXX", 0.1, "m"), motion_value("ECC", 0.5, "rad"), square, own, Parameter("offset", "m"))
    published = SimpleNamespace(theta=np.arange(5.0), covariance=4.0 * np.eye(5), determined=np.ones(5, dtype=bool))
    found: Any = SimpleNamespace(assembly=SimpleNamespace(parameters=every), published=published)
    assert _rotary(found) == {"rotary": {"ECC": {"nodes": [0.5], "value": [1.0], "value_u": [2.0]}}}


def test_effect_of_one_session_only(several: SimpleNamespace) -> None:
    tracker = several.measured("tracker", 4)
    run = several.measured("run", 4, effects=[{"id": "backlash_x", "size": 2e-6}])
    result = identify_sessions(FitRequest((tracker.session, run.session), ("tracker", "run"), effects=("backlash_x",)))
    assert result.effects == ("backlash_x",)
    assert "backlash_x.b" in {p.name for p in result.parameters}


def test_several_of_one_are_that_one(several: SimpleNamespace) -> None:
    session = several.measured("run", 0).session
    alone = identify_sessions(FitRequest((session,), ("a",)))
    np.testing.assert_array_equal(alone.error_map.error, identify(session).error_map.error)


@pytest.mark.parametrize(("labels", "message"), [(["a", "a"], "label of its own"), (["a", "b", "c"], "label")])
def test_bad_requests(several: SimpleNamespace, labels: list[str], message: str) -> None:
    session = several.measured("run", 0).session
    with pytest.raises(ModelError, match=message):
        joint_models(FitRequest((session, session), tuple(labels)))


def test_a_model_that_no_session_has(several: SimpleNamespace) -> None:
    sessions = tuple(several.measured(name, 0).session for name in ("tracker", "run"))
    with pytest.raises(ModelError, match=r"none of the sessions has a model 'fre' \(did you mean 'free'\?\)"):
        joint_models(FitRequest(sessions, ("a", "b"), "fre"))


def test_another_machine(several: SimpleNamespace) -> None:
    run = several.measured("run", 0).session
    machine = run.description.machine.model_copy(update={"chain": "w-Y-b-X-Z-t"})
    other = type(run)(run.description.model_copy(update={"machine": machine}), run.readings)
    with pytest.raises(ModelError, match="session 'b' is of a machine with another chain"):
        identify_sessions(FitRequest((run, other), ("a", "b")))


def test_effect_that_acts_in_none(several: SimpleNamespace) -> None:
    session = several.measured("run", 0).session
    with pytest.raises(ModelError, match="effect mirror_misalignment acts in no session"):
        identify_sessions(FitRequest((session, session), ("a", "b"), effects=("mirror_misalignment",)))


def test_two_tools_of_different_reach_tell_the_yaw(several: SimpleNamespace) -> None:
    """EXX read at the spindle and 0.2 m beside it: the difference is the yaw ECX times 0.2 m (Abbe)."""
    sessions = []
    for seed, reach in ((1, 0.0), (2, 0.2)):
        machine = {**several.machine(5), "tool_offset": (0.0, reach, 0.0)}
        plan = {**several.PLANS["run"], "chain": several.CHAIN, "terms": ("EXX", "ECX")}
        sessions.append(simulate(SimulationSpec.model_validate({"seed": seed, "plan": plan, "machine": machine})))
    result = identify_sessions(FitRequest(tuple(s.session for s in sessions), ("short", "long")))
    found = {e.name: e for e in result.parameters}
    truth = sessions[0].truth.machine.motion("ECX", several.nodes)
    assert np.abs(truth).max() > 8e-6
    for node, true in zip(several.nodes[1:], truth[1:], strict=True):
        estimate = found[f"ECX({node:.6g})"]
        assert abs(estimate.value - (true - truth[0])) < 4 * estimate.standard_uncertainty
        assert estimate.standard_uncertainty < 2e-6
    left = {entry.name for entry in identify(sessions[1].session).not_determined}
    assert {f"{name}({node:.6g})" for name in ("EXX", "ECX") for node in several.nodes[1:]} <= left


@pytest.mark.parametrize("names", [("run",), ("run", "grid")])
def test_a_session_in_which_nothing_stands_out_is_modelled_once(
    several: SimpleNamespace, monkeypatch: pytest.MonkeyPatch, names: tuple[str, ...]
) -> None:
    sessions, made = tuple(several.measured(name, 0).session for name in names), []

    def counted(session: Session, model: str | None) -> Any:
        made.append(session)
        return build_model(session, model)

    monkeypatch.setattr("machine_tool_calibration.methods.fitted.build_model", counted)
    identify_sessions(FitRequest(sessions, names))
    assert made == list(sessions)


def _two_trackers(several: SimpleNamespace, seed: int, size: float | None) -> JointResult:
    effects = (FlawSpec(id="warmup_y", size=size, parameters={"tau": 900.0}),) if size else ()
    machine = several.machine(seed)
    sessions = [several.measured("tracker", seed + k, machine, effects=effects).session for k in range(2)]
    return identify_sessions(FitRequest(sessions, ("first", "second"), effects=("warmup_y",)))


@pytest.mark.long
def test_a_time_constant_is_shared(several: SimpleNamespace, many: Any) -> None:
    normalised = []
    some = many.part(0.25)
    for seed in range(0, 2 * some.count, 2):
        found = {p.name: p for p in _two_trackers(several, seed, 6e-6).parameters}
        for name, true in (("first/warmup_y.a", 6e-6), ("second/warmup_y.a", 6e-6), ("warmup_y.tau", 900.0)):
            normalised.append((found[name].value - true) / found[name].standard_uncertainty)
    low, high = stats.chi2.ppf([0.01, 0.99], 2 * some.count) / (2 * some.count)
    assert low < np.mean(np.square(normalised)) < high


def test_a_time_constant_of_nothing_is_not_published(several: SimpleNamespace) -> None:
    result = _two_trackers(several, 0, None)
    names = {p.name for p in result.parameters}
    assert "first/warmup_y.a" in names and "warmup_y.tau" not in names
    why = {entry.name: entry.why for entry in result.not_determined}
    assert "do not bound it" in why["warmup_y.tau"]


def test_a_place_of_which_a_component_was_never_read_has_none_of_it() -> None:
    """Y alone is read between two of nine places, and X at both ends by the same session: nobody knows EXY between."""
    rng, noise = np.random.default_rng(3), 2e-7

    def measured(x: np.ndarray, y: np.ndarray, along: np.ndarray) -> Session:
        true = np.where(along, 3e-6 * np.sin(12.0 * y) + 1e-6, 5e-6 * y)
        columns = {"x": x, "y": y, "z": 0.0, "gx": along, "gy": 1.0 - along}
        columns["displacement"] = true + noise * rng.normal(size=len(x))
        return plates.session(columns, noise, "offset", ("EXX", "EYY", "EXY", "EYX"))

    x, y = (np.tile(axis.ravel(), 2) for axis in np.meshgrid(np.linspace(0.0, 0.4, 5), np.linspace(0.0, 0.4, 9)))
    grid = measured(x, y, np.repeat([1.0, 0.0], len(x) // 2))
    between = np.array([0.0, 0.1, 0.225, 0.3, 0.4])
    corners = np.array([0.0, 0.4, 0.0, 0.4])
    line = measured(
        np.append(0.0 * between, corners), np.append(between, np.sort(corners)), np.repeat([0.0, 1.0], [5, 4])
    )
    found = identify_sessions(FitRequest((grid, line), ("grid", "line"))).error_map
    (at,) = np.flatnonzero(np.abs(found.points[:, 1] - 0.225) < 1e-9)
    assert np.isnan(found.error[at, 0]) and np.isfinite(found.error[at, 1])
    assert np.isfinite(np.delete(found.error, at, axis=0)[:, :2]).all()


def test_nodes_of_all_sessions_are_kept_until_there_are_very_many() -> None:
    even = np.linspace(0.0, 0.6, 61)
    np.testing.assert_allclose(_union([even[::2], even[1::2]]), even)
    many = _union([even, even[:-1] + 0.005])
    np.testing.assert_allclose(many, even[::2])
