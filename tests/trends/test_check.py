# SPDX-License-Identifier: Apache-2.0
"""Whether an earlier map still holds: nothing is called changed that is not, and what has changed is named."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.budget.published import Numbers, Quantity
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import fitted_sessions, identify_sessions
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.simulation.machine_file import MachineSpec
from machine_tool_calibration.trends.check import LEVEL, SESSIONS, between_sessions, check
from machine_tool_calibration.trends.statement import Part, Statement, of_fit, of_result

AT = np.linspace(0.0, 0.4, 6)


@cache
def measured(seed: int, squareness: float = 0.0) -> tuple[Result, Statement]:
    """One machine, measured anew with each seed, whose squareness may have changed."""
    effects = (FlawSpec(id="C0Y", size=squareness),) if squareness else ()
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=seed, machine=MachineSpec(seed=7), effects=effects)
    found = identify_sessions(FitRequest((simulate(spec).session,), model="rigid_body"))
    assert isinstance(found, Result)
    return found, of_fit(fitted_sessions(found), str(seed), draws=200)


def statement(value: Array, u: float, label: str, name: str = "EYX", draws: int = 0, seed: int = 1) -> Statement:
    """A measurement that states one motion along an axis, or one number, with independent uncertainties."""
    count = len(value)
    members, at = np.arange(count), AT if count == len(AT) else None
    listed = (Quantity(name, "m", 0, count, lambda k: "", at),)
    return Statement(
        label=label,
        date=None,
        method="direct",
        model="tables",
        effects=(),
        sha256=label,
        numbers=Numbers(np.asarray(value), np.full(count, u), listed),
        points=np.zeros((0, 3)),
        parts={name: Part(name, "m", members, at)},
        samples=u * np.random.default_rng(seed).standard_normal((draws, count)) if draws else None,
    )


def test_a_machine_that_did_not_change_is_not_called_changed() -> None:
    for seed in range(11, 23, 2):
        found = check(measured(seed)[1], measured(seed + 1)[1])
        assert not found.moved and {one.name for one in found.changes} >= {"EXX", "ECY", "C0Y", "position_error"}


def test_a_squareness_that_changed_is_named_with_its_size_and_no_motion_beside_it() -> None:
    found = check(measured(11)[1], measured(12, 12e-6)[1])
    (moved,) = (one for one in found.moved if one.name != "position_error")
    assert moved.name == "C0Y"
    assert abs(moved.change - 12e-6) < 4 * moved.u < 12e-6
    # The position errors are made of it.
    assert "position_error" in {one.name for one in found.moved}


def test_what_the_coordinate_system_changes_is_no_change() -> None:
    curve = 3e-6 * np.sin(9.0 * AT)
    first = statement(curve, 1e-7, "first", draws=200)
    for name, more, moved in (("EYX", 2e-5 * AT + 1e-5, 0), ("EXX", 1e-5 + 0 * AT, 0), ("EXX", 2e-5 * AT, 1)):
        one = replace(first, parts={name: replace(first.parts["EYX"], name=name)})
        two = statement(curve + more, 1e-7, "second", name, draws=200, seed=2)
        assert len(check(one, two).moved) == moved, (name, more)


def test_p_values_are_adjusted_by_the_rule_of_holm() -> None:
    found = check(measured(11)[1], measured(12)[1])
    p = np.array([one.p_value for one in found.changes])
    assert np.all(np.diff(p) >= 0)
    expected = [min(1.0, max((len(p) - j) * p[j] for j in range(k + 1))) for k in range(len(p))]
    np.testing.assert_allclose([one.adjusted for one in found.changes], expected)


def test_of_a_document_a_change_is_found_without_correlations() -> None:
    result, _ = measured(11)
    document = of_result(result.document(), "result.json")
    assert document.sha256 == measured(11)[1].sha256
    same, other = check(document, measured(12)[1]), check(document, measured(12, 30e-6)[1])
    assert not same.moved and not same.correlated
    assert "C0Y" in {one.name for one in other.moved}
    with pytest.raises(CalibrationError, match="no correlations"):
        check(replace(document, model="free"), measured(12)[1])


def test_a_document_says_the_same_numbers_as_the_fit() -> None:
    result, stated = measured(11)
    document = of_result(result.document(), "result.json")
    assert {*document.parts} == {*stated.parts}
    for name, part in document.parts.items():
        other = stated.parts[name]
        np.testing.assert_allclose(document.numbers.value[part.members], stated.numbers.value[other.members])
        np.testing.assert_allclose(document.numbers.u[part.members], stated.numbers.u[other.members])
    np.testing.assert_array_equal(document.points, stated.points)
    np.testing.assert_allclose(document.position_error[1], stated.position_error[1])


def test_the_spread_between_sessions_is_told_by_earlier_ones_and_counts() -> None:
    rng = np.random.default_rng(4)
    size, u = 2e-6, 1e-7
    rows = [statement(size * rng.standard_normal(6), u, str(k), draws=200, seed=k) for k in range(30)]
    told = between_sessions(rows)["EYX"]
    assert told == pytest.approx(size, rel=0.25)
    # A jump between two sessions makes it no larger.
    jumped = [*rows[:15], *(statement(one.numbers.value + 1e-4 * AT, u, f"{k}+") for k, one in enumerate(rows[15:]))]
    assert between_sessions(jumped)["EYX"] == pytest.approx(told, rel=0.1)
    for last in (rows[-2:], [replace(one, samples=None) for one in rows[-2:]]):
        (found,) = check(*last, rows[:-1]).changes
        assert check(*last).moved and not found.moved
        # Of each of both, and of a motion with samples without its mean and slope.
        assert found.u == pytest.approx(np.sqrt(2.0) * found.between, rel=0.3 if last[0].samples is not None else 0.01)
    assert between_sessions(rows[: SESSIONS - 1]) == {}
    quiet = [statement(u * rng.standard_normal(6), u, f"q{k}") for k in range(40)]
    assert between_sessions(quiet)["EYX"] < u


def test_the_spread_of_position_errors_counts_likewise() -> None:
    rng, points = np.random.default_rng(5), np.array([[x, y, 0.0] for x in AT for y in AT])

    def placed(k: int, draws: int) -> Statement:
        value = 2e-6 * rng.standard_normal(3 * len(points))
        one = statement(value, 1e-7, f"{draws} {k}", "position_error", draws, seed=k)
        return replace(one, points=points, parts={})

    for draws in (300, 0):
        rows = [placed(k, draws) for k in range(20)]
        found = check(rows[-2], rows[-1], rows[:-1])
        assert check(rows[-2], rows[-1]).moved and not found.moved
        assert found.changes[0].between == pytest.approx(2e-6, rel=0.1) and found.changes[0].along is not None


def test_values_that_one_of_both_lacks_are_left_out() -> None:
    value = 1e-6 * np.ones(6)
    first, second = (
        statement(value, 1e-7, "first"),
        statement(np.array([1e-6, np.nan, 5e-6, 1e-6, 1e-6, 1e-6]), 1e-7, "b"),
    )
    (found,) = check(first, second).changes
    assert found.moved and found.at == (AT[2],) and found.change == pytest.approx(4e-6)
    assert found.u == pytest.approx(np.sqrt(2) * 1e-7)


def test_what_was_too_uncertain_and_what_only_one_has_is_said() -> None:
    first = statement(np.array([1e-6]), 1e-6, "first", "C0Y")
    found = check(first, statement(np.array([2e-6]), 1e-6, "second", "C0Y"))
    assert [one.name for one in found.blind] == ["C0Y"] and found.changes[0].p_value > LEVEL
    more = replace(first, parts={**first.parts, "A0Z": replace(first.parts["C0Y"], name="A0Z")})
    assert check(more, statement(np.array([2e-6]), 1e-6, "second", "C0Y")).untold == ("A0Z",)
    with pytest.raises(CalibrationError, match="no error in common"):
        check(first, statement(np.array([2e-6]), 1e-6, "second", "B0Z"))


def test_the_measurement_that_the_map_was_made_from_is_refused() -> None:
    with pytest.raises(CalibrationError, match="was made from"):
        check(measured(11)[1], measured(11)[1])
