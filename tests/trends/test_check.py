# SPDX-License-Identifier: Apache-2.0
"""Whether an earlier map still holds: nothing is called changed that is not, and what has changed is named.
Steady, jumped, drifting or read by another sensor: each is found for what it is, and nothing where nothing is.
"""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.budget.published import Numbers, Quantity
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.estimation.priors import ALL_REPRODUCES
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import fitted_sessions, identify_sessions
from machine_tool_calibration.methods.map_comparison import LEVEL
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.reports.trends import check_remarks, check_verdict
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.simulation.machine_file import MachineSpec
from machine_tool_calibration.trends.check import SESSIONS, between_sessions, check
from machine_tool_calibration.trends.statement import Part, Statement, of_fit, of_result
from machine_tool_calibration.trends.trend import ALARM, CHANGED, SHIFTED, Explanation, _cases, explain

from ..told import keys

AT = np.linspace(0.0, 0.4, 6)


@cache
def measured(seed: int, squareness: float = 0.0) -> tuple[Result, Statement]:
    """One machine, measured anew with each seed, whose squareness may have changed."""
    effects = (FlawSpec(id="C0Y", size=squareness),) if squareness else ()
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=seed, machine=MachineSpec(seed=7), effects=effects)
    found = identify_sessions(FitRequest((simulate(spec).session,), model="rigid_body"))
    assert isinstance(found, Result)
    return found, of_fit(fitted_sessions(found), str(seed), draws=200)


def statement(
    value: Array, u: float, label: str, name: str = "EYX", draws: int = 0, seed: int = 1, at: Array | None = None
) -> Statement:
    """A measurement that states one motion along an axis, or one number, with independent uncertainties."""
    count = len(value)
    members, at = np.arange(count), AT if at is None and count == len(AT) else at
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


@pytest.mark.long
def test_a_machine_that_did_not_change_is_not_called_changed() -> None:
    for seed in range(11, 23, 2):
        found = check(measured(seed)[1], measured(seed + 1)[1])
        assert not found.moved and {one.name for one in found.changes} >= {"EXX", "ECY", "C0Y", "position_error"}


@pytest.mark.long
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


@pytest.mark.long
def test_p_values_are_adjusted_by_the_rule_of_holm() -> None:
    found = check(measured(11)[1], measured(12)[1])
    p = np.array([one.p_value for one in found.changes])
    assert np.all(np.diff(p) >= 0)
    expected = [min(1.0, max((len(p) - j) * p[j] for j in range(k + 1))) for k in range(len(p))]
    np.testing.assert_allclose([one.adjusted for one in found.changes], expected)


@pytest.mark.long
def test_of_a_document_a_change_is_found_without_correlations() -> None:
    result, _ = measured(11)
    document = of_result(result.document(), "result.json")
    assert document.sha256 == measured(11)[1].sha256
    same, other = check(document, measured(12)[1]), check(document, measured(12, 30e-6)[1])
    assert not same.moved and not same.correlated
    assert "C0Y" in {one.name for one in other.moved}
    with pytest.raises(CalibrationError, match="no correlations"):
        check(replace(document, model="free"), measured(12)[1])


@pytest.mark.parametrize("u", [-1e-6, np.inf, np.nan])
def test_an_uncertainty_that_is_none_is_refused_by_file_and_key(u: float) -> None:
    content = measured(11)[0].document()
    (chosen,) = (one for one in content["parameters"] if one["name"] == "C0Y")
    damaged = content | {"parameters": [{**one, "standard_uncertainty": u} if one is chosen else one
                                        for one in content["parameters"]]}  # fmt: skip
    with pytest.raises(CalibrationError, match=rf"^result\.json: C0Y, value 1: {u:g} is no standard uncertainty$"):
        of_result(damaged, "result.json")


def test_a_number_of_a_document_too_large_for_any_float_is_refused() -> None:
    content = measured(11)[0].document()
    damaged = content | {"parameters": [one | {"value": 10**400} for one in content["parameters"]]}
    with pytest.raises(CalibrationError, match=r"^result\.json: is damaged, or no result document of mtcal \(Overflow"):
        of_result(damaged, "result.json")


@pytest.mark.long
def test_a_reversal_that_the_model_lacks_hides_no_change_of_scale() -> None:
    """Both directions of both measurements are 4 um apart: their means tell a change of 4 um at the end."""

    def axis(seed: int, scale: float) -> Statement:
        flaws = (FlawSpec(id="backlash_x", size=2e-6), FlawSpec(id="scale", size=scale))
        plan = PRESETS["iso230_2"].model_copy(update={"noise": 3e-7})
        session = simulate(SimulationSpec(plan=plan, seed=seed, machine=MachineSpec(seed=7), effects=flaws)).session
        return of_fit(fitted_sessions(identify_sessions(FitRequest((session,)))), str(seed), draws=200)

    before = axis(1, 0.0)
    assert "EXX" in {one.name for one in check(before, axis(2, 10e-6)).moved}
    assert not check(before, axis(3, 0.0)).moved


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
    told = between_sessions(rows)["EYX"].size
    assert told == pytest.approx(size, rel=0.25)
    # A jump between two sessions makes it no larger.
    jumped = [*rows[:15], *(statement(one.numbers.value + 1e-4 * AT, u, f"{k}+") for k, one in enumerate(rows[15:]))]
    assert between_sessions(jumped)["EYX"].size == pytest.approx(told, rel=0.1)
    for last in (rows[-2:], [replace(one, samples=None) for one in rows[-2:]]):
        (found,) = check(*last, rows[:-1]).changes
        assert check(*last).moved and not found.moved
        # Of each of both, as values that are independent and as courses; a motion with samples has no mean and slope.
        assert np.sqrt(2.0) * (0.7 if last[0].samples is not None else 1.0) < found.u / found.between < 2.5
    assert between_sessions(rows[: SESSIONS - 1]) == {}
    quiet = [statement(u * rng.standard_normal(6), u, f"q{k}") for k in range(40)]
    assert between_sessions(quiet)["EYX"].size < u


@pytest.mark.parametrize("sessions", [6, 16])
def test_sessions_that_differ_by_bows_are_not_called_changed(sessions: int) -> None:
    """What changes from session to session is one course along the axis, and no value of each position."""
    rng, bow = np.random.default_rng(6), (AT / AT[-1] - 0.5) ** 2
    size, u, moved, found = 1e-5, 1e-8, 0, 0
    for k in range(20):
        values = [size * rng.standard_normal() * bow for _ in range(sessions)]
        rows = [statement(value, u, f"{k} {j}", draws=200, seed=100 * k + j) for j, value in enumerate(values)]
        worn = statement(values[-1] + 1e-4 * np.sin(6.0 * AT), u, f"{k} worn", draws=200, seed=k)
        moved += len(check(rows[-2], rows[-1], rows[:-1]).moved)
        found += len(check(rows[-2], worn, rows[:-1]).moved)
    assert moved <= 1 and found == 20


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


@pytest.mark.parametrize("draws", [0, 300])
def test_motions_that_were_read_at_other_positions_are_compared_between_these(draws: int) -> None:
    at, between, u, bent, moved = np.linspace(0.0, 0.4, 11), np.linspace(0.02, 0.38, 10), 5e-7, 0, 0

    def read(where: Array, more: float, seed: int) -> Statement:
        noise = u * np.random.default_rng(seed).standard_normal(len(where))
        value = 2e-5 * np.sin(9.0 * where) + more * (where > 0.2) + noise
        return statement(value, u, f"{len(where)} {more} {seed}", "EXX", draws, seed, where)

    for seed in range(40):
        earlier = read(at, 0.0, 2 * seed)
        (same,) = check(earlier, read(between, 0.0, 2 * seed + 1)).changes
        (other,) = check(earlier, read(between, 8e-6, 2 * seed + 1)).changes
        bent, moved = bent + same.moved, moved + other.moved
        assert 0.0 < other.at[0] < 0.4 and other.rms > 2e-6
    assert bent <= 2 and moved == 40


def test_how_many_places_of_the_earlier_map_are_compared_is_said() -> None:
    points = np.array([[x, 0.0, 0.0] for x in AT])
    value = np.zeros(3 * len(points))
    earlier = replace(statement(value, 1e-6, "earlier", "position_error"), points=points, parts={})
    kept = statement(value[6:], 1e-6, "now", "position_error")
    found = check(earlier, replace(kept, points=points[2:], parts={}))
    assert found.places == (len(AT) - 2, len(AT))
    assert f"{len(AT) - 2} of {len(AT)} of the earlier map" in " ".join(check_remarks(found))


def test_what_was_too_uncertain_and_what_only_one_has_is_said() -> None:
    first = statement(np.array([1e-6]), 1e-6, "first", "C0Y")
    found = check(first, statement(np.array([2e-6]), 1e-6, "second", "C0Y"))
    assert [one.name for one in found.blind] == ["C0Y"] and found.changes[0].p_value > LEVEL
    more = replace(first, parts={**first.parts, "A0Z": replace(first.parts["C0Y"], name="A0Z")})
    assert check(more, statement(np.array([2e-6]), 1e-6, "second", "C0Y")).not_compared == ("A0Z",)
    with pytest.raises(CalibrationError, match="no error in common"):
        check(first, statement(np.array([2e-6]), 1e-6, "second", "B0Z"))


@pytest.mark.long
def test_the_measurement_that_the_map_was_made_from_is_refused() -> None:
    with pytest.raises(CalibrationError, match="was made from"):
        check(measured(11)[1], measured(11)[1])


N = 30
MONTHS = 30.4 * np.arange(N)
ONE, U = np.zeros(N, dtype=np.int64), np.ones(N)
OTHER = (np.arange(N) >= 15).astype(np.int64)
NUMBERS = 24


def explained(value: Array, way: Array = ONE, u: Array = U, n: int = N) -> Explanation:
    """The first sessions of a machine of which many numbers are followed."""
    return explain(MONTHS[:n], value[:n], u[:n], way[:n].astype(np.int64), NUMBERS)


def noise(seed: int, size: float = 1.0) -> Array:
    return size * np.random.default_rng(seed).standard_normal(N)


@pytest.mark.parametrize("size", [0.3, 1.0, 4.0])
def test_a_steady_machine_raises_no_alarm_and_its_spread_is_learned(size: float) -> None:
    found = [explained(noise(seed, size)) for seed in range(40)]
    assert max(one.probability for one in found) < ALARM
    # What the sessions' own uncertainty does not explain.
    assert np.median([one.spread for one in found]) == pytest.approx(np.sqrt(max(size**2 - 1.0, 0.0)), abs=0.3)


YEAR = 20.0 - 2.5 * np.cos(2.0 * np.pi * np.arange(N) / 12.0)  # from a January on


@pytest.mark.parametrize(("n", "unknown"), [(6, []), (12, []), (30, []), (12, [3, 8])])
def test_a_season_is_no_drift_where_its_temperature_was_recorded(n: int, unknown: list[int]) -> None:
    """By 3 U for each kelvin: a warming spring would be an alarm, in some; of some sessions it may not be known."""
    alarms, known = 0, YEAR[:n].copy()
    known[unknown] = np.nan
    for seed in range(10):
        value = noise(seed) + 3.0 * (YEAR - 20.0)
        found = explain(MONTHS[:n], value[:n], U[:n], ONE[:n], NUMBERS, known)
        alarms += explained(value, n=n).changed
        assert not found.changed
        assert n < 12 or found.warms
        assert abs(found.per_kelvin - 3.0) < 4.0 * found.u_per_kelvin < 1.5
    assert (alarms > 0) == (n == 6)


def test_a_jump_beside_a_season_is_found_and_at_one_temperature_nothing_goes_with_it() -> None:
    for seed in range(10):
        value = noise(seed) + 3.0 * (YEAR - 20.0) + 8.0 * (np.arange(N) >= 15)
        found = explain(MONTHS, value, U, ONE, NUMBERS, YEAR)
        assert found.jump > ALARM and found.first <= 14 < 15 <= found.last
        still = explain(MONTHS, value, U, ONE, NUMBERS, 20.0 + 0.02 * (YEAR - 20.0))
        assert still == explained(value) and still.warm == 0.0


@pytest.mark.long
def test_thirty_quiet_machines_raise_no_alarm_however_often_one_looks() -> None:
    for seed in range(30):
        rng = np.random.default_rng(1000 + seed)
        value = rng.standard_normal((4, N))
        assert not any(explained(value[q], n=n).changed for q in range(4) for n in (5, 10, 15, 20, 25, 30))


@pytest.mark.parametrize("sign", [1, -1])
def test_a_jump_is_found_within_two_sessions_with_its_size_and_date(sign: int) -> None:
    for seed in range(10):
        value = noise(seed) + sign * 8.0 * (np.arange(N) >= 15)
        assert not explained(value, n=15).changed
        assert explained(value, n=17).changed
        found = explained(value)
        assert found.jump > ALARM and abs(found.change - 8.0 * sign) < 4.0 * found.u < 3.0
        assert found.first <= 14 < 15 <= found.last and found.last - found.first <= 2


def test_a_drift_is_no_jump_and_begins_where_it_begins() -> None:
    for seed in range(10):
        found = explained(noise(seed) + np.maximum(np.arange(N) - 10.0, 0.0))
        assert found.drift > ALARM
        assert abs(found.change - 19.0) < 4.0 * found.u and found.first <= 10 <= found.last


@pytest.mark.long
def test_another_sensor_explains_a_step_and_a_jump_beside_it_is_still_found() -> None:
    for seed in range(10):
        stepped = noise(seed) + 8.0 * OTHER
        found = explained(stepped, OTHER)
        assert found.shifted and not found.changed
        assert abs(found.step - 8.0) < 4.0 * found.u_step
        assert explained(stepped).changed and not explained(noise(seed), OTHER).shifted
        both = explained(stepped + 8.0 * (np.arange(N) >= 22), OTHER)
        assert both.shifted and both.jump > ALARM and both.first <= 21 < 22 <= both.last


def test_a_sensor_that_comes_back_tells_a_shift_from_a_jump() -> None:
    """The new sensor is in use in some months only: a machine that jumped stays so when the old one is back."""
    visiting = ((np.arange(N) >= 12) & (np.arange(N) < 18)).astype(np.int64)
    shifted = explained(noise(3) + 8.0 * visiting, visiting)
    jumped = explained(noise(3) + 8.0 * (np.arange(N) >= 12), visiting)
    assert shifted.shifted and not shifted.changed
    assert jumped.changed and not jumped.shifted


def test_what_a_change_would_be_does_not_depend_on_how_probable_it_is() -> None:
    value = noise(2) + 2.5 * (np.arange(N) >= 15)
    few, many = (explain(MONTHS, value, U, ONE, among) for among in (1, 100_000))
    assert few.probability > 0.9 > 0.1 > many.probability
    assert many.jump > many.drift and many.change == pytest.approx(few.change, rel=0.05)
    assert many.u == pytest.approx(few.u, rel=0.1) and (many.first, many.last) == (few.first, few.last)


@pytest.mark.long
def test_the_spread_between_sessions_is_in_the_uncertainty_of_a_step() -> None:
    for size in (1.0, 5.0):
        found = [explained(noise(seed, size) + 40.0 * OTHER, OTHER) for seed in range(10)]
        assert np.median([one.u_step for one in found]) == pytest.approx(size * np.sqrt(2.0 / 15.0), rel=0.2)


@pytest.mark.parametrize("warm", [False, True])
@pytest.mark.parametrize("ways", [1, 3])
def test_the_prior_is_a_probability_and_has_the_tail_of_half_cauchy(ways: int, warm: bool) -> None:
    cases = _cases(ways, warm)
    assert any(one.warm > 0 for one in cases) == warm
    chance = np.exp([one.prior for one in cases])
    assert chance.sum() == pytest.approx(1.0)
    beyond = chance[[one.spread > 10.0 for one in cases]].sum() / (1.0 - ALL_REPRODUCES)
    assert beyond == pytest.approx(1.0 - 2.0 / np.pi * np.arctan(10.0), abs=0.03)
    assert chance[[one.shift > 0 for one in cases]].sum() == pytest.approx(SHIFTED if ways > 1 else 0.0)


def test_units_and_level_make_no_difference() -> None:
    value = noise(5) + 6.0 * (np.arange(N) >= 20)
    one, two = explained(value), explained(3e-6 + 1e-6 * value, u=1e-6 * U)
    assert two.jump == pytest.approx(one.jump) and two.change == pytest.approx(1e-6 * one.change)
    assert two.u == pytest.approx(1e-6 * one.u) and two.spread == pytest.approx(1e-6 * one.spread)


def test_the_odds_are_those_of_the_integral(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three values without spread and one size: the density of the data, averaged over the level, in closed form."""
    from machine_tool_calibration.trends import trend as room

    monkeypatch.setattr(room, "_SPREADS", np.array([0.0, 1e-9]))
    monkeypatch.setattr(room, "_SIZES", np.array([2.0]))
    days, value, u = np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.5, 4.0]), np.array([1.0, 1.5, 1.0])
    found = explain(days, value, u, np.zeros(3, dtype=np.int64))
    wide = partial(multivariate_normal.pdf, value, np.zeros(3))
    base = np.diag(u**2) + 1e6 * np.ones((3, 3))
    changes = np.array([[0.0, 1.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.5, 1.0]])
    each = [wide(base + 4.0 * np.outer(column, column)) for column in changes]
    weights = CHANGED / 2 * np.array([0.5, 0.5, 1.0])
    total = (1.0 - CHANGED) * wide(base) + weights @ each
    assert found.jump == pytest.approx(weights[:2] @ each[:2] / total, rel=1e-4)
    assert found.drift == pytest.approx(weights[2] * each[2] / total, rel=1e-4)


def test_readings_that_contradict_any_model_leave_open_whether_the_map_holds() -> None:
    """More than those of the map did theirs; where these did as well, it is said, and the rest is compared."""
    still = 5e-6 * np.ones(1)
    before = statement(still, 1e-7, "before", "C0Y")
    after = replace(statement(still, 1e-7, "after", "C0Y"), scatter=(9.0, 300))
    found = check(before, after)
    assert (found.holds, found.contradicted, found.misfit) == (None, True, True)
    assert keys(check_verdict(found))[0] == "check.contradicted" and "3.00 times" in check_verdict(found)
    then = check(replace(before, scatter=(9.5, 300)), replace(after, scatter=(1.0, 300)))
    assert (then.holds, then.misfit, then.map_misfit) == (True, False, True)
    assert "check.map_misfit" in [key for words in check_remarks(then) for key in keys(words)]
    both = check(replace(before, scatter=(9.5, 300)), after)
    assert (both.holds, both.contradicted, both.misfit) == (True, False, True)
    assert "check.misfit" in [key for words in check_remarks(both) for key in keys(words)]
    within = check(before, replace(after, scatter=(1.1, 300)))
    assert (within.holds, within.contradicted, within.misfit) == (True, False, False)


def test_a_difference_that_chance_seldom_makes_is_neither_a_change_nor_none() -> None:
    found = check(*(statement(np.full(1, 5e-6), 1e-7, label, "C0Y") for label in ("before", "after")))
    maybe = replace(found, changes=tuple(replace(one, adjusted=0.03) for one in found.changes))
    assert maybe.holds is None and not maybe.moved and not maybe.blind and maybe.open == maybe.changes
    assert keys(check_verdict(maybe))[0] == "check.may_fail"
    assert replace(found, changes=tuple(replace(one, adjusted=0.06) for one in found.changes)).open == ()


def test_where_all_is_too_uncertain_it_is_open_whether_the_map_holds() -> None:
    sizes = {"before": 5e-6, "after": 1e-6}
    found = check(*(statement(np.array([size]), 8e-6, label, "C0Y") for label, size in sizes.items()))
    assert found.holds is None and keys(check_verdict(found))[0] == "check.open"


def test_a_motion_that_is_nowhere_determined_is_not_compared() -> None:
    """Of which the datum's zero is known alone."""
    both = []
    for label in ("before", "after"):
        known, zero = statement(np.array([5e-6]), 1e-7, label, "C0Y"), statement(np.full(6, np.nan), np.nan, label)
        values = np.array([5e-6, 0.0, *np.full(5, np.nan)]), np.array([1e-7, 0.0, *np.full(5, np.nan)])
        parts = known.parts | {"EYX": replace(zero.parts["EYX"], members=np.arange(1, 7))}
        both.append(replace(known, numbers=Numbers(*values, known.numbers.quantities), parts=parts))
    found = check(*both)
    assert [one.name for one in found.changes] == ["C0Y"]
    assert found.not_compared == ("EYX",)


def test_sessions_that_read_other_positions_tell_the_spread_where_all_reach() -> None:
    """Slopes of 5 um over the axis from one session to the next, read at six and at eleven places by turns.

    One session of a hundredth of the axis says nothing of it.
    """
    rng = np.random.default_rng(8)

    def read(count: int, label: str) -> Statement:
        at = np.linspace(0.0, 0.4, count)
        value = 5e-6 * rng.standard_normal() * at / 0.4 + 1e-8 * rng.standard_normal(count)
        return statement(value, 1e-8, label, "EXX", at=at)

    history = [read((6, 11)[k % 2], str(k)) for k in range(12)]
    spread = between_sessions(history)["EXX"]
    assert spread.at == pytest.approx(AT)
    assert 5e-7 < spread.size < 5e-6
    found = check(history[-1], read(11, "now"), history)
    assert found.sessions == 12 and not found.moved
    short = statement(1e-8 * rng.standard_normal(6), 1e-8, "short", "EXX", at=np.linspace(0.19, 0.2, 6))
    assert between_sessions([*history, short])["EXX"].size == pytest.approx(spread.size)
    assert "EXX" not in between_sessions([*history[:4], short])


def test_where_a_plan_counts_from_is_no_spread() -> None:
    """The same scale, of which one plan has its zero 50 mm farther on than the other: a step of 1.5 um stands out."""
    rng = np.random.default_rng(9)

    def read(first: float, label: str, step: float = 0.0) -> Statement:
        at = np.linspace(first, first + 0.4, 9)
        value = 2e-5 * (at - first) + step * (at > 0.2) + 1e-7 * rng.standard_normal(9)
        return statement(value, 1e-7, label, "EXX", at=at)

    history = [read(0.05 * (k % 2), str(k)) for k in range(12)]
    assert between_sessions(history)["EXX"].size < 1e-7
    assert check(history[-1], read(0.0, "now", 1.5e-6), history).moved
