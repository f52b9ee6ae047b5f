# SPDX-License-Identifier: Apache-2.0
"""The readings of one session, divided among several: the machine's unknowns mean the same in each.
What a fit of several sessions leaves of further columns, against dense least squares.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FitRequest, joint_models
from machine_tool_calibration.methods.identify import JointResult, identify, identify_sessions
from machine_tool_calibration.model.fit import fit_models, screen, screen_joint
from machine_tool_calibration.model.model import Parameter, Term
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


@pytest.mark.long
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


def term(name: str, columns: np.ndarray, shared: bool) -> Term:
    """Columns with the unknowns name.0, name.1, …"""
    parameters = tuple(Parameter(f"{name}.{k}", "1", shared=shared) for k in range(len(columns)))
    return Term(name, parameters, columns)


def dense(joint, columns: np.ndarray) -> np.ndarray:
    """Inner products of columns (k, all readings) and residual, after least squares with every unknown, points too.

    The rows are those of the linearised readings, the datum is held exactly; nothing is eliminated on the way.
    """
    problem, solution = joint.assembly.problem, joint.solution
    sizes = [part.dimension * part.n_points for part in problem.parts]
    first_point = problem.size + np.cumsum([0, *sizes])
    first_row = np.cumsum([0, *(part.n_readings for part in problem.parts)])
    jacobian = np.zeros((first_row[-1], first_point[-1]))
    residual, weight = np.zeros(first_row[-1]), np.zeros(first_row[-1])
    for number, part in enumerate(problem.parts):
        for group, chunk in part.chunks():
            rows = part.rows(group, chunk, solution.theta, solution.local[number])
            layout = part.groups[group]
            for slot, block in enumerate(layout.block):
                for place, reading in enumerate(layout.rows[slot, chunk]):
                    if reading < 0:
                        continue
                    row = first_row[number] + reading
                    np.add.at(jacobian[row], part.block_index[block], rows.block[:, slot, place])
                    np.add.at(jacobian[row], part.dense_index, rows.dense[:, slot, place])
                    if part.dimension:
                        point = np.arange(part.n_points)[layout.pick(chunk)][place]
                        own = first_point[number] + point * part.dimension + np.arange(part.dimension)
                        jacobian[row, own] = rows.local[:, slot, place]
                    residual[row] = rows.residual[slot, place]
    sigma = np.concatenate([model.sigma for model in joint.assembly.models])
    weight = 1.0 / sigma
    if problem.priors is not None:
        priors = problem.priors
        more = np.zeros((len(priors.value), jacobian.shape[1]))
        more[:, : problem.size] = priors.columns / priors.sigma[:, None]
        jacobian = np.vstack([jacobian, more])
        residual = np.append(residual, (priors.value - priors.columns @ solution.theta) / priors.sigma)
        columns = np.column_stack([columns, np.zeros((len(columns), len(more)))])
        weight = np.append(weight, np.zeros(len(more)))
    datum = np.zeros((len(problem.constraints), jacobian.shape[1]))
    datum[:, : problem.size] = problem.constraints
    _, values, vectors = np.linalg.svd(datum)
    free = jacobian @ vectors[int((values > 1e-9 * values.max(initial=1.0)).sum()) :].T
    free = free / np.maximum(np.linalg.norm(free, axis=0), 1e-300)
    left, values, _ = np.linalg.svd(free, full_matrices=False)
    left = left[:, values > 1e-9]
    wanted = np.vstack([columns * weight, residual])
    wanted = wanted - (wanted @ left) @ left.T
    return wanted @ wanted.T


@pytest.fixture(scope="module")
def joint(several):
    """A tracker and a run of one axis, in one fit."""
    sessions = [several.measured(name, 3).session for name in ("tracker", "run")]
    common, _ = joint_models(FitRequest(sessions, ("tracker", "run")))
    return fit_models(common.models, ["tracker", "run"])


@pytest.fixture(scope="module")
def blocks(joint):
    """For each session, columns that nothing else holds."""
    rng = np.random.default_rng(5)
    return [rng.normal(size=(2, len(model.observations))) for model in joint.assembly.models]


def test_the_machines_unknowns_are_one_column_and_others_one_for_each_session(joint, blocks):
    one, two = blocks
    terms = [
        [term("own", one[:1], False), term("common", one, True)],
        [term("common", two, True), term("own", two[1:], False)],
    ]
    screened = screen_joint(joint, terms)
    assert screened.names == ("tracker/own.0", "common.0", "common.1", "run/own.0")
    none = [np.zeros((1, b.shape[1])) for b in blocks]
    columns = np.vstack(
        [np.column_stack([one[:1], none[1]]), np.column_stack([one, two]), np.column_stack([none[0], two[1:]])]
    )
    expected = dense(joint, columns)
    assert expected[-1, -1] == pytest.approx(joint.solution.chi_square, rel=1e-6)
    assert np.allclose(screened.gram[:-1, :-1], expected[:-1, :-1], rtol=1e-6, atol=1e-6 * expected[0, 0])
    size = np.sqrt(np.outer(np.diag(expected)[:-1], expected[-1:, -1]))[:, 0]
    assert np.allclose(screened.gram[:-1, -1] / size, expected[:-1, -1] / size, atol=1e-4)
    assert np.allclose(
        screened.squares[:-1], ((columns / np.concatenate([m.sigma for m in joint.assembly.models])) ** 2).sum(axis=1)
    )


def test_what_is_screened_is_what_a_fit_finds(joint, blocks):
    """The gain in the sum of squares, and the coefficients, of a fit with the terms in it."""
    terms = [[term("common", block, True)] for block in blocks]
    gram = screen_joint(joint, terms).gram
    size = np.linalg.solve(gram[:-1, :-1], gram[:-1, -1])
    models = [model.with_terms(own) for model, own in zip(joint.assembly.models, terms, strict=True)]
    fitted = fit_models(models, ["tracker", "run"])
    names = [p.name for p in fitted.assembly.parameters]
    found = fitted.solution.theta[[names.index("common.0"), names.index("common.1")]]
    assert np.allclose(size, found, rtol=1e-3)
    assert joint.solution.chi_square - fitted.solution.chi_square == pytest.approx(gram[:-1, -1] @ size, abs=2e-3)


def test_a_name_of_the_model_is_a_further_column_all_the_same(joint):
    """It repeats the model's own unknown: nothing is left of it."""
    first = next(t for t in joint.assembly.models[0].terms if t.name == "EXX")
    screened = screen_joint(joint, [[first], []])
    assert screened.names == tuple(p.name for p in first.parameters)
    seen = screened.squares[:-1] > 0.0
    assert (np.diag(screened.gram)[:-1][seen] < screened.squares[:-1][seen]).all()


def test_one_session_by_itself(several):
    session = several.measured("run", 4).session
    joint = fit_models([build_model(session)[0]])
    columns = np.random.default_rng(6).normal(size=(3, len(joint.assembly.models[0].observations)))
    screened = screen(joint.fits[0], columns)
    assert np.allclose(screened.gram[:-1], dense(joint, columns)[:-1], rtol=1e-6, atol=1e-6 * screened.gram[0, 0])
    # The same without columns kept.
    by_terms = screen_joint(joint, [[term("column", columns, True)]])
    assert np.allclose(by_terms.gram, screened.gram, rtol=1e-9, atol=1e-9 * screened.gram[0, 0])
    assert np.allclose(by_terms.response, screened.response, rtol=1e-9, atol=1e-9 * np.abs(screened.response).max())


def test_columns_of_one_of_several_sessions(joint, blocks):
    """A column of one session's readings is zero in the others."""
    screened = screen(joint.fits[1], blocks[1])
    columns = np.column_stack([np.zeros((2, blocks[0].shape[1])), blocks[1]])
    assert np.allclose(
        screened.gram[:-1, :-1], dense(joint, columns)[:-1, :-1], rtol=1e-6, atol=1e-6 * screened.gram[0, 0]
    )


def test_a_name_twice_in_one_session(joint, blocks):
    with pytest.raises(ModelError, match="twice"):
        screen_joint(joint, [[term("a", blocks[0], True), term("a", blocks[0], True)], []])
