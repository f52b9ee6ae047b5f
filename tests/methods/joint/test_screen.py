# SPDX-License-Identifier: Apache-2.0
"""What a fit of several sessions leaves of further columns, against dense least squares."""

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FitRequest, joint_models
from machine_tool_calibration.model.fit import fit_models, screen, screen_joint
from machine_tool_calibration.model.model import Parameter, Term


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
