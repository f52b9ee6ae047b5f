# SPDX-License-Identifier: Apache-2.0
"""Putting models together: what is shared, what is named, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.json_types import plain
from machine_tool_calibration.model.fit import changed, fit_models
from machine_tool_calibration.model.model import Constraint, Parameter, Prior, Term, assemble, motion_value
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.result import ErrorMap, Estimate, Result, correlated_with
from machine_tool_calibration.session.parse import describe

from .. import plates
from ..line_model import Line

X = np.linspace(-1.0, 1.0, 9)


class Coarse(Line):
    """Readings whose last digit is more than what was declared."""

    @property
    def sigma(self):
        return 3.0 * self.declared_sigma


def error_map(fit):
    points = np.zeros((1, 3))
    return ErrorMap({"points": points, "scale": fit.theta[1:2], "hole": np.array([np.nan])}, points, points, points)


def line(displacement, terms=("scale",), *, shared=True, constraints=(), priors=()):
    session = plates.session({"x": X, "displacement": displacement}, 1e-6, machine={"chain": "w-X-b-t"})
    zero = np.zeros((9, 3))
    observations = Observations(session, session.readings, zero, zero, zero, np.zeros(9), np.zeros(9, dtype=int))
    made = tuple(Term(name, (Parameter(name, "1", shared=shared),), X[None]) for name in terms)
    return Line(observations, made, tuple(constraints), tuple(priors), (), "none", 0.5)


def test_two_sessions_share_the_machines_unknowns_only():
    assembly = assemble([line(X), line(X)], ["first", "second"])
    assert [p.name for p in assembly.parameters] == ["first/offset", "scale", "second/offset"]
    assert [place.tolist() for place in assembly.places] == [[0, 1], [2, 1]]
    assert len(assembly.problem.parts) == 2


def test_two_sessions_of_one_machine_are_weighted_together():
    joint = fit_models([line(2e-6 * X + 1e-6), line(4e-6 * X - 1e-6)], ["a", "b"])
    assert joint.fits[0].theta[1] == pytest.approx(3e-6)
    assert joint.fits[1].theta[0] == pytest.approx(-1e-6)
    assert joint.solution.degrees_of_freedom == 15
    assert np.allclose(joint.fits[0].residuals, -1e-6 * X)
    alone = fit_models([line(2e-6 * X + 1e-6)])
    assert joint.fits[0].covariance[1, 1] == pytest.approx(alone.fits[0].covariance[1, 1] / 2)


def test_unknowns_of_instruments_are_not_shared():
    assembly = assemble([line(X, shared=False), line(X, shared=False)], ["a", "b"])
    assert [p.name for p in assembly.parameters] == ["a/offset", "a/scale", "b/offset", "b/scale"]


def test_the_same_unknown_twice_is_an_error():
    with pytest.raises(ModelError, match="'scale' twice"):
        assemble([line(X, terms=("scale", "scale"))])


def test_a_datum_about_nothing_is_an_error():
    with pytest.raises(ModelError, match="'tilt'"):
        assemble([line(X, constraints=[Constraint({"tilt": 1.0})])])


def test_constraint_and_prior():
    held = fit_models([line(2e-6 * X, constraints=[Constraint({"scale": 1.0}, 1e-6)])])
    assert held.fits[0].theta[1] == pytest.approx(1e-6)
    assert held.solution.chi_square == pytest.approx(np.sum(X**2))
    known = fit_models([line(2e-6 * X, priors=[Prior({"scale": 1.0}, 0.0, 1e-12)])])
    assert known.fits[0].theta[1] == pytest.approx(0.0, abs=1e-9)
    assert known.solution.degrees_of_freedom == held.solution.degrees_of_freedom == 8


def test_what_is_known_besides_the_readings_is_no_worse_for_their_scatter():
    """A scale known as well as the readings were declared to tell it, which scatter five times as much."""
    known = Prior({"scale": 1.0}, 2e-6, 1e-6 / np.linalg.norm(X))
    joint = fit_models([line(2e-6 * X + 5e-6 * (-1.0) ** np.arange(9), priors=[known])])
    scatter = joint.marginal.scatter
    assert scatter > 4.0
    # Its mean with what the readings say.
    expected = known.sigma**2 * (scatter**2 + 1.0) / 4.0
    assert joint.published.covariance[1, 1] == pytest.approx(expected)


@pytest.mark.parametrize("again", [False, True])
def test_other_readings_and_other_knowledge_are_weighted_as_those_before(again: bool):
    """A scale known as well as the readings tell it goes half the way that either goes."""
    known = fit_models([line(2e-6 * X, priors=[Prior({"scale": 1.0}, 2e-6, 1e-6 / np.linalg.norm(X))])])
    assert changed(known, [1e-6 * X], again=again).solution.theta[1] == pytest.approx(2.5e-6)
    assert changed(known, [0.0 * X], np.array([-1e-6]), again=again).solution.theta[1] == pytest.approx(1.5e-6)
    assert changed(fit_models([line(2e-6 * X)]), [1e-6 * X], np.zeros(0)).solution.theta[1] == pytest.approx(3e-6)


def test_too_few_readings():
    model = line(X)
    model = replace(
        model,
        observations=replace(
            model.observations,
            readings=model.observations.readings.select(np.arange(2)),
            path=model.observations.path[:2],
            direction=model.observations.direction[:2],
        ),
        terms=(Term("scale", model.terms[0].parameters, X[None, :2]),),
    )
    with pytest.raises(ModelError, match=rf"^{model.observations.session.source}: too few readings: 2 for 2 unknowns"):
        fit_models([model])


def test_p_value_and_predicted():
    joint = fit_models([line(2e-6 * X + 1e-6 * (-1.0) ** np.arange(9))])
    (fit,) = joint.fits
    assert joint.reduced_chi_square == pytest.approx(joint.solution.chi_square / 7)
    assert 0.1 < joint.p_value < 0.5
    # Readings that count less by their last digit are held against what was declared all the same.
    rounded = fit_models([Coarse(**vars(fit.model))])
    assert rounded.variance == pytest.approx(joint.variance / 9)
    assert rounded.reduced_chi_square == pytest.approx(joint.reduced_chi_square)
    assert np.allclose(fit.predicted + fit.residuals, fit.model.observations.readings.displacement)


def result_of(model):
    fit = fit_models([model]).fits[0]
    found = error_map(fit)
    return Result(fit=fit, error_map=found, effects=("scale",), model_name="line", rejected=(), observations=9)


def test_published_value_counts_from_its_reference(reproducible):
    estimates = {e.name: e for e in result_of(line(3e-6 + 2e-6 * X)).parameters}
    assert estimates["offset"].value == pytest.approx(0.5 + 3e-6, abs=1e-15)
    assert estimates["offset"].standard_uncertainty == pytest.approx(1e-6 / 3)
    assert estimates["scale"].unit == "1"


def test_what_cannot_be_told_apart_is_named_and_not_given_as_a_number():
    result = result_of(line(2e-6 * X, terms=("scale", "lead")))
    assert [e.name for e in result.parameters] == ["offset"]
    assert {n.name: n.why for n in result.not_determined} == {
        "scale": "fully correlated with lead",
        "lead": "fully correlated with scale",
    }


def test_a_value_of_a_table_says_where_it_is_in_it():
    at = Estimate.of(motion_value("EXX", 0.08, "m"), 2e-6, 1e-7).document()
    assert at == {"name": "EXX(0.08)", "value": 2e-6, "standard_uncertainty": 1e-7, "unit": "m",
                  "error_motion": "EXX", "position": 0.08}  # fmt: skip
    # Of a value at a setup, and of what is no table, no position is a number.
    for parameter in (motion_value("ECC", "C1", "rad"), Parameter("offset", "m", reference=0.5)):
        assert set(Estimate.of(parameter, 0.0, 1e-7).document()) == {"name", "value", "standard_uncertainty", "unit"}


def test_document_is_the_contracts():
    document = result_of(line(2e-6 * X)).document()
    assert document["format"] == "mtcal-result/1"
    assert document["observations"] == document["used"] == 9
    assert document["error_map"]["hole"] == [None]
    assert document["error_map"]["scale"] == pytest.approx([2e-6])
    assert set(document) >= {
        "method", "rejected", "rms_residual", "reduced_chi_square", "degrees_of_freedom", "p_value", "effects",
        "parameters", "not_determined",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (np.array([[1.0, np.nan], [np.inf, 2.0]]), [[1.0, None], [None, 2.0]]),
        (np.array([1, 2]), [1, 2]),
        (np.array(["a", "b"]), ["a", "b"]),
        (np.array([True]), [True]),
        ((1.0, float("nan")), [1.0, None]),
        ({"a": np.float64(3.0), "b": np.int64(4)}, {"a": 3.0, "b": 4}),
        (np.zeros((0, 3)), []),
        ("text", "text"),
    ],
)
def test_plain(value, expected):
    assert plain(value) == expected


def test_the_declared_uncertainty_grows_with_the_length_and_is_each_setups():
    model = line(X)
    session = model.observations.session
    said = {"displacement": 2e-6, "per_length": 3e-6, "setups": {"two": {"displacement": 1e-6, "per_length": 5e-7}}}
    content = session.description.model_dump() | {
        "standard_uncertainty": said,
        "setups": [{"id": "one"}, {"id": "two"}],
    }
    setup = np.arange(9) // 6
    observations = replace(
        model.observations,
        session=replace(session, description=describe(content, "here")),
        readings=replace(session.readings, setup=setup),
        path=X,
    )
    expected = np.where(setup == 0, 2e-6 + 3e-6 * np.abs(X), 1e-6 + 5e-7 * np.abs(X))
    assert replace(model, observations=observations).sigma == pytest.approx(expected)


def test_columns_of_a_position_error():
    model = line(X)
    directions = np.tile([0.6, 0.8, 0.0], (9, 1))
    observations = replace(model.observations, direction=directions)
    field = np.zeros((2, 9, 3))
    field[0, :, 0], field[1, :, 1] = X, 1.0
    assert np.allclose(observations.sense(field), [0.6 * X, np.full(9, 0.8)])


def test_what_the_points_take_up_is_read_all_the_same() -> None:
    alone = np.eye(2)[:, :1]
    assert correlated_with(alone, ["a", "b"], 0) == "no reading depends on it"
    assert correlated_with(alone, ["a", "b"], 0, points=True) == "fully correlated with the points of the map"
