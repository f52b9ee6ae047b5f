# SPDX-License-Identifier: Apache-2.0
"""The readings of one session, divided among several: the machine's unknowns mean the same in each."""

from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.fitted import FitRequest, joint_models
from machine_tool_calibration.methods.identify import JointResult, identify, identify_sessions
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.model.rigid_body import map_field
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation.simulate import Simulated, simulate
from machine_tool_calibration.simulation.spec import SimulationSpec


def tracked(seed: int, dimension: int, travel: bool = True, **more: object) -> Simulated:
    """A tracking interferometer at four stations; the travel of the machine declared or not."""
    plan = {"method": "tracking_interferometer", "dimension": dimension}
    made = simulate(SimulationSpec.model_validate({"seed": seed, "plan": plan, **more}))
    if travel:
        return made
    return Simulated(undeclared(made.session), made.truth)


def undeclared(session: Session) -> Session:
    machine = session.description.machine.model_copy(update={"travel": {}})
    return type(session)(session.description.model_copy(update={"machine": machine}), session.readings)


def divided(session: Session, key: np.ndarray) -> list[Session]:
    return [session.with_readings(session.readings.select(key == k)) for k in np.unique(key)]


def together(session: Session, key: np.ndarray, effects: list[str]) -> JointResult:
    parts = divided(session, key)
    return identify_sessions(FitRequest(parts, tuple(f"s{k}" for k in range(len(parts))), effects=effects))


def apart(one: Result, several: JointResult) -> np.ndarray:
    """(n, 3) map of one session less that of several, without what readings leave open."""
    first, second = (np.lexsort(np.round(r.error_map.points, 7).T) for r in (one, several))
    points, tables = several.error_map.points[second], several.common.tables
    assert np.allclose(one.error_map.points[first], points, atol=1e-8)
    difference = one.error_map.error[first] - several.error_map.error[second]
    known = np.isfinite(difference)
    assert known.sum() == np.isfinite(one.error_map.error).sum()
    field = map_field(tables, points)[:, known]
    open_ = np.array([several.common.fixed[label] for table in tables for label in table.labels]).T @ field
    left, size, _ = np.linalg.svd(open_.T, full_matrices=False)
    left = left[:, size > 1e-9]
    values: np.ndarray = difference[known] - left @ (left.T @ difference[known])
    return values


@pytest.mark.parametrize(
    ("dimension", "effects", "travel"),
    [
        (2, ["ECX"], True),
        (2, ["EYX", "ECX"], False),
        (2, ["pitch_periodic_x"], True),
        (3, [], True),
        (3, ["thermal_expansion_x", "EAY"], False),
    ],
)
def test_four_sessions_of_one_station_are_one_session_of_four(
    reproducible: None, dimension: int, effects: list[str], travel: bool
) -> None:
    """The unknowns are the same: those of the machine, and of each station."""
    session = tracked(3, dimension, travel).session
    one = identify(session, model="rigid_body", effects=effects)
    several = together(session, session.readings.setup, effects)
    assert several.fit.solution.chi_square == pytest.approx(one.fit.solution.chi_square, rel=1e-7)
    assert several.fit.solution.degrees_of_freedom == one.fit.solution.degrees_of_freedom
    assert np.abs(apart(one, several)).max() < 1e-12
    assert not several.agreement.contradictions
    alike = {p.name: p for p in several.parameters}
    for estimate in one.parameters:
        if estimate.name.split(".")[0] in effects:
            assert alike[estimate.name].value == pytest.approx(estimate.value, rel=1e-5)
            assert alike[estimate.name].standard_uncertainty == pytest.approx(estimate.standard_uncertainty, rel=1e-5)


def test_an_error_motion_is_the_same_function_in_sessions_at_different_places(several: SimpleNamespace) -> None:
    """Its columns in the parts are those of the whole, with a declared travel and without."""
    for whole in (tracked(4, 2).session, undeclared(tracked(4, 2).session)):
        key = (whole.readings.column("x") > 0.15).astype(int)
        common, _ = joint_models(FitRequest(divided(whole, key), ("low", "high"), effects=("ECX",)))
        observed = identify(whole, model="rigid_body").fit.model.observations
        expected = catalogue()["ECX"].columns(observed)
        for k, model in enumerate(common.models):
            (term,) = (term for term in model.terms if term.name == "ECX")
            assert np.allclose(term.columns, expected[:, key == k], atol=1e-12)


@pytest.mark.parametrize(
    ("ends", "expected"),
    [((-0.02, 0.44), (-0.02, 0.44)), ((0.1, 0.6), (0.0, 0.4)), ((-0.1, 0.6), (0.0, 0.4)), (None, (0.0, 0.4))],
)
def test_the_span_is_the_travel_where_readings_fill_it(ends, expected) -> None:
    session = tracked(4, 2).session
    travel = {} if ends is None else {"X": ends}
    machine = session.description.machine.model_copy(update={"travel": travel})
    session = type(session)(session.description.model_copy(update={"machine": machine}), session.readings)
    assert identify(session).fit.model.observations.span("x") == pytest.approx(expected)


def test_each_session_has_its_own_start_of_time() -> None:
    """Drifts and instruments are each session's, and the map is as good as that of one session."""
    made = tracked(5, 2, effects=[{"id": "warmup_x", "size": 8e-6, "parameters": {"tau": 600.0}}])
    several = together(made.session, made.session.readings.repeat, ["warmup_x", "linear_drift"])
    names = {p.name for p in several.parameters}
    assert {"s0/warmup_x.a", "s1/warmup_x.a", "s0/linear_drift.r", "s1/linear_drift.r"} <= names
    assert several.fit.p_value > 1e-3


@pytest.mark.parametrize("method", ["probing", "direct", "step_diagonal"])
def test_a_session_of_which_no_reading_is_left_is_refused(method: str) -> None:
    session = simulate(SimulationSpec.model_validate({"seed": 3, "plan": {"method": method}})).session
    emptied = session.without(np.ones(len(session.readings), dtype=bool))
    with pytest.raises(ModelError, match="no reading is left"):
        joint_models(FitRequest((session, emptied), ("a", "b")))


def test_a_setup_without_readings_changes_nothing() -> None:
    """Stations that were declared and never read leave the map as it is."""
    session = tracked(6, 2).session
    setups = session.description.setups
    parts = []
    for k, part in enumerate(divided(session, session.readings.setup)):
        bare = part.description.model_copy(update={"setups": setups[k : k + 1]})
        readings = part.readings.select(np.arange(len(part.readings)))
        parts.append(
            type(part)(bare, type(readings)(**{**vars(readings), "setup": np.zeros(len(readings), dtype=int)}))
        )
    bare_result = identify_sessions(FitRequest(parts, list("abcd")))
    declared = together(session, session.readings.setup, [])
    assert np.allclose(bare_result.error_map.error, declared.error_map.error, atol=1e-12, equal_nan=True)
