# SPDX-License-Identifier: Apache-2.0
"""Conformity against probabilities worked out by hand."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from machine_tool_calibration.budget import conformity as of_conformity
from machine_tool_calibration.budget.conformity import (
    INCOMPLETE,
    ONLY_IF_RIGHT,
    RULES,
    Conformity,
    Verdict,
    conformity,
    decide,
)
from machine_tool_calibration.budget.contributor import template_of
from machine_tool_calibration.budget.propagate import Budget, propagate
from machine_tool_calibration.budget.tolerances import parse_tolerances, read_tolerances
from machine_tool_calibration.errors import CalibrationError, ModelError, SessionError
from machine_tool_calibration.methods.fitted import FitRequest, FittedSessions, fit_sessions
from machine_tool_calibration.session.contributor import Contributor
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, DiagonalPlan, FlawSpec, SimulationSpec, TrackingPlan, simulate

from ..told import keys

# Readings that scatter by next to nothing.
QUIET = {"standard_uncertainty": {"displacement": 1e-10}}
# Declared 1 µm, four runs: the mean at each position is known to 0.5 µm.
U = 0.5e-6


def one(found: Conformity) -> Verdict:
    """The only verdict."""
    assert len(found.each) == 1
    return found.each[0]


def scatter_alone(fitted: FittedSessions) -> Budget:
    """A budget of nothing but the declared scatter of the readings."""
    sigma = float(fitted.joint.assembly.models[0].sigma[0])
    line = Contributor(name="noise", type="A", standard_uncertainty=sigma, enters="reading", varies="reading")
    return propagate(fitted, [line])


def judged(
    fitted: FittedSessions, tolerances: dict[str, float], budget: Budget | None = None, **said: Any
) -> Conformity:
    """With a budget of the scatter alone, if none is given."""
    return conformity(fitted, tolerances, budget=budget or scatter_alone(fitted), **said)


def of_exx(fitted: FittedSessions, tolerance: float, **said: Any) -> Verdict:
    """Of the range of EXX."""
    return one(judged(fitted, {"EXX": tolerance}, **said))


@pytest.mark.long
def test_range_of_independent_values(reproducible: None, runs: Callable[..., Session]) -> None:
    """Two ends 10 µm apart and what is between them out of the way: their difference is normal with 0.5 sqrt(2) µm."""
    fitted = fit_sessions(runs(np.tile([0.0, 5.1e-6, 4.93e-6, 5.02e-6, 10e-6], 4)))
    budget = scatter_alone(fitted)
    for tolerance in (9.5e-6, 10e-6, 10.5e-6, 11.5e-6):
        found = of_exx(fitted, tolerance, budget=budget)
        expected = stats.norm.cdf((tolerance - 10e-6) / (U * np.sqrt(2.0)))
        # 150 samples carry the correlation, which is uncertain by a twelfth: of the difference's uncertainty 4 %.
        assert found.probability == pytest.approx(expected, abs=0.03)
        assert found.value == pytest.approx(10e-6)
        assert found.u == pytest.approx(U * np.sqrt(2.0), rel=0.15)


@pytest.mark.long
def test_range_of_equal_values_is_not_normal(reproducible: None, runs: Callable[..., Session]) -> None:
    """Five equal values: the true range scatters about theirs as ranges of five do about their median.

    Those of chance alone are 2.3 u, and as large a true one would have been seen.
    """
    fitted = fit_sessions(runs())
    drawn = np.ptp(np.random.default_rng(3).normal(size=(20_000, 5)), axis=1)
    budget = scatter_alone(fitted)
    for tolerance in (0.5, 1.0, 2.326):
        found = of_exx(fitted, tolerance * U, budget=budget)
        assert found.value == pytest.approx(0.0, abs=1e-12)
        assert found.probability == pytest.approx(np.mean(drawn - np.median(drawn) <= tolerance), abs=0.05)
    assert found.decision == "pass"
    assert of_exx(fitted, U, budget=budget).decision == "undecided"


@pytest.mark.long
@pytest.mark.parametrize("seed", [2, 6, 10])
def test_noise_alone_fails_nobody(reproducible: None, seed: int) -> None:
    """Points that are known worse than the tolerance, of which the largest comes out at twice what it is."""
    exact = simulate(SimulationSpec(plan=TrackingPlan(dimension=2), seed=3, noise_factor=0.0)).session
    sigma = exact.description.standard_uncertainty.model_copy(update={"displacement": 1e-5})
    exact = replace(exact, description=exact.description.model_copy(update={"standard_uncertainty": sigma}))
    true = one(judged(fit_sessions(exact), {"volumetric": 1.0})).value
    noise = 1e-5 * np.random.default_rng(seed).normal(size=len(exact.readings))
    moved = replace(exact.readings, displacement=exact.readings.displacement + noise)
    found = judged(fit_sessions(exact.with_readings(moved)), {"volumetric": 1.05 * true})
    assert one(found).value > 2.0 * true
    assert found.decision == "undecided"


@pytest.mark.long
def test_squareness_by_the_normal_distribution() -> None:
    """On either side of zero."""
    fitted = fit_sessions(simulate(SimulationSpec(plan=DiagonalPlan(blocks=3), seed=1)).session)
    content = fitted.error_map.content["squareness"]
    value, u = content["C0Y"], content["C0Y_u"]
    budget = scatter_alone(fitted)
    for tolerance in (abs(value), abs(value) + u, abs(value) + 3 * u):
        found = one(judged(fitted, {"C0Y": tolerance}, budget))
        expected = stats.norm.cdf(tolerance, value, u) - stats.norm.cdf(-tolerance, value, u)
        assert (found.value, found.u) == pytest.approx((value, u))
        assert found.probability == pytest.approx(expected)
    assert found.decision == "pass"
    assert one(judged(fitted, {"C0Y": abs(value) / 10}, budget)).decision == "fail"


def test_straightness_is_about_its_line(reproducible: None, runs: Callable[..., Session]) -> None:
    """A slope is no straightness error; a deviation of 6 µm in the middle of five is."""
    x = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    session = runs(np.tile(20e-6 * x + np.array([0, 0, 6e-6, 0, 0]), 4), terms=["EYX"])
    columns = {**session.readings.columns, "gx": np.zeros(20), "gy": np.ones(20)}
    across = replace(session.readings, columns=columns)
    found = one(judged(fit_sessions(session.with_readings(across)), {"EYX": 10e-6}))
    assert found.value == pytest.approx(6e-6)
    assert found.decision == "pass"


def test_the_nearest_values_that_keep_a_straightness_are_those_about_its_line() -> None:
    x, bent = np.array([0.0, 0.1, 0.2, 0.3, 0.4]), np.array([0.0, 0.0, 6.0, 0.0, 0.0])
    straightness = of_conformity._extent(x)
    assert straightness.work_out(bent + 20.0 * x) == pytest.approx(6.0)
    # Of a line through all, at 1.2, the middle one is 4.8 beyond and the others 1.2 below: half a unit less each.
    expected = [-0.7, -0.7, 4.3, -0.7, -0.7]
    assert straightness.within(bent + 20.0 * x, 5.0) == pytest.approx(expected)


def test_draws_of_many_values_are_made_in_parts_of_so_many_numbers(
    reproducible: None, runs: Callable[..., Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(of_conformity, "_DRAWS", 1000)
    monkeypatch.setattr(of_conformity, "_SAMPLES", 10)
    fitted = fit_sessions(runs(np.tile([0.0, 1e-6, 3e-6, 2e-6, 5e-6], 4)))
    judge = of_conformity._Conformity(fitted, scatter_alone(fitted), 0, lambda what, share: None)
    (figure,), parts = judge.figures("EXX"), list[tuple[int, ...]]()
    assert figure.kind is not None
    work_out = figure.kind.work_out

    def spied(values: Any) -> Any:
        parts.append(values.shape)
        return work_out(values)

    figure = replace(figure, kind=replace(figure.kind, work_out=spied))
    values, u = (every[figure.members] for every in (judge.numbers.value, judge.u))
    at_once = judge.draws(figure, values, u)
    monkeypatch.setattr(of_conformity, "_NUMBERS", 5 * 300 + 4)
    assert judge.draws(figure, values, u) == pytest.approx(at_once)
    assert parts == [(1000, 5), (300, 5), (300, 5), (300, 5), (100, 5)]


@pytest.mark.long
def test_volumetric_error(reproducible: None) -> None:
    """The largest of many lengths: what was measured neither conforms to itself nor fails."""
    fitted = fit_sessions(simulate(SimulationSpec(plan=TrackingPlan(dimension=2), seed=3)).session)
    length = np.linalg.norm(fitted.error_map.error[:, :2], axis=1)
    found = one(judged(fitted, {"volumetric": float(length.max())}))
    assert found.value == pytest.approx(length.max())
    assert found.probability == pytest.approx(0.5, abs=0.01)
    assert found.decision == "undecided"
    assert one(judged(fitted, {"volumetric": 2 * float(length.max())})).decision == "pass"


@pytest.mark.long
def test_budget_takes_the_place_of_the_identification(
    runs: Callable[..., Session], contributor: Callable[..., Contributor]
) -> None:
    """A length error of 2 µm/m makes a range over 0.4 m uncertain by 0.8 µm and nothing else."""
    fitted = fit_sessions(runs(np.tile(20e-6 * np.array([0.0, 0.1, 0.2, 0.3, 0.4]), 4), **QUIET))
    budget = propagate(fitted, [contributor("length", "never")])
    found = conformity(fitted, {"EXX": 8.8e-6}, budget=budget)
    assert found.uncertainty == "budget"
    assert one(found).probability == pytest.approx(stats.norm.cdf(1.0), abs=0.02)
    assert one(found).u == pytest.approx(0.8e-6, rel=0.05)


@pytest.mark.long
def test_few_degrees_of_freedom(runs: Callable[..., Session], contributor: Callable[..., Contributor]) -> None:
    """Student's t in place of the normal distribution, for what is drawn as well."""
    fitted = fit_sessions(runs(np.tile(20e-6 * np.array([0.0, 0.1, 0.2, 0.3, 0.4]), 4), **QUIET))
    budget = propagate(fitted, [contributor("length", "never", degrees_of_freedom=2.0)])
    found = conformity(fitted, {"EXX": 9.6e-6, "A_X": 1e-6}, budget=budget)
    assert found.each[0].probability == pytest.approx(stats.t.cdf(2.0, 2.0), abs=0.02)
    assert stats.norm.cdf(2.0) - stats.t.cdf(2.0, 2.0) > 0.05


@pytest.mark.long
def test_nothing_is_decided_without_a_budget(fitted: FittedSessions) -> None:
    """What the readings show lacks instrument and temperature: neither a tolerance of a metre passes, nor any fails."""
    for rule in RULES:
        found = conformity(fitted, {"EXX": 1.0, "A_X": 1e-12}, rule=rule)
        assert {verdict.decision for verdict in found.each} <= {"undecided", "not determined"}
        assert found.each[0].why == INCOMPLETE and np.isnan(found.each[0].probability)
        assert found.decision != "pass"


@pytest.mark.long
def test_nothing_is_decided_by_a_model_that_the_readings_contradict(reproducible: None) -> None:
    """A backlash that the model lacks; with it in the model the same tolerances are kept and missed."""
    session = simulate(
        SimulationSpec(plan=TrackingPlan(dimension=2), effects=(FlawSpec(id="backlash_x", size=5e-6),), seed=3)
    ).session
    tolerances = {"volumetric": 1e-3}
    lacking, whole = fit_sessions(session), fit_sessions(FitRequest((session,), effects=("backlash_x",)))
    assert lacking.joint.p_value < 1e-3 < whole.joint.p_value
    for rule in RULES:
        found = one(judged(lacking, tolerances, rule=rule))
        assert (found.decision, found.why) == ("undecided", ONLY_IF_RIGHT) and np.isnan(found.probability)
    assert one(judged(whole, tolerances)).decision == "pass"


def test_a_reversal_that_is_read_directly_is_part_of_the_result(reproducible: None) -> None:
    """Runs of ISO 230-2: the mean of both directions does not fit them, and their uncertainty holds all the same."""
    spec = SimulationSpec(plan=PRESETS["iso230_2"], effects=(FlawSpec(id="backlash_x", size=5e-6),), seed=5)
    fitted = fit_sessions(simulate(spec).session)
    assert fitted.joint.p_value < 1e-3
    found = judged(fitted, {"EXX": 1e-3, "A": 1e-3, "B": 1e-6})
    assert [verdict.decision for verdict in found.each] == ["pass", "pass", "fail"]


@pytest.mark.long
def test_what_is_suspicious_is_said(runs: Callable[..., Session]) -> None:
    assert any("all 20 readings are 0" in words for words in judged(fit_sessions(runs()), {"EXX": 1.0}).suspicious)
    assert not judged(fit_sessions(runs(np.random.default_rng(2).normal(0.0, 1e-6, 20))), {"EXX": 1.0}).suspicious


@pytest.mark.long
def test_what_the_readings_show_is_not_undercut(
    runs: Callable[..., Session], contributor: Callable[..., Contributor]
) -> None:
    """A budget that forgets the scatter of the readings does not make it small."""
    fitted = fit_sessions(runs(np.random.default_rng(2).normal(0.0, 1e-6, 20)))
    budget = propagate(fitted, [contributor("length", "never", 1e-9)])
    assert budget.complete == pytest.approx(budget.numbers.u, nan_ok=True)
    assert one(conformity(fitted, {"EXX": 1e-5}, budget=budget)).u > 0.1e-6


@pytest.mark.long
def test_not_determined_never_passes(fitted: FittedSessions) -> None:
    found = judged(fitted, {"EXX": 1.0, "C0Y": 1.0, "EAX": 1.0, "A": 1.0}, rule="simple")
    assert [verdict.decision for verdict in found.each][1:3] == ["not determined", "not determined"]
    assert found.each[0].decision == "pass"
    assert found.decision == "not determined"
    assert all(verdict.why and np.isnan(verdict.probability) for verdict in found.each[1:3])


def test_a_lost_target_leaves_the_volumetric_error_open() -> None:
    session = simulate(SimulationSpec(plan=TrackingPlan(dimension=2), seed=3)).session
    readings = session.readings
    first = (readings.columns["x"] == readings.columns["x"][0]) & (readings.columns["y"] == readings.columns["y"][0])
    lost = session.with_readings(readings.select(~first | (readings.setup == 0)))
    found = one(judged(fit_sessions(lost), {"volumetric": 1.0}))
    assert found.decision == "not determined"
    assert "target" in found.why


def test_figures_of_iso_230_2(runs: Callable[..., Session], contributor: Callable[..., Contributor]) -> None:
    there = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
    session = runs()
    readings = session.readings
    sense = np.where(np.arange(20) // 5 % 2 == 0, 1.0, -1.0)
    columns = {**readings.columns, "x": np.tile(np.concatenate([there, there[::-1]]), 2), "dir_x": sense}
    deviation = 20e-6 * columns["x"] + 1e-7 * np.random.default_rng(1).standard_normal(20)
    moved = type(readings)(readings.setup, readings.repeat // 2, deviation, columns, readings.labels, readings.row)
    fitted = fit_sessions(session.with_readings(moved))
    run = fitted.error_map.content["iso230_2"][0]
    m, u = run["M"], run["M_U"] / 2.0
    budget = propagate(fitted, [contributor("length", "never", 1e-15)])
    found = conformity(fitted, {"M": m + u, "M_X": m - u, "B_mean_X": 1e-6, "A_Y": 1e-6}, budget=budget)
    assert [verdict.name for verdict in found.each] == ["M_X", "M_X", "B_mean_X", "A_Y"]
    assert [v.probability for v in found.each[:2]] == pytest.approx([stats.norm.cdf(1.0), stats.norm.cdf(-1.0)])
    assert [v.decision for v in found.each] == ["undecided", "undecided", "pass", "not determined"]


def test_of_runs_in_one_direction_its_own_figures_are_what_can_be_asked_for(runs: Callable[..., Session]) -> None:
    session = runs(1e-6 * np.random.default_rng(2).standard_normal(20))
    columns = {**session.readings.columns, "dir_x": -np.ones(20)}
    fitted = fit_sessions(session.with_readings(replace(session.readings, columns=columns)))
    both, one_way = judged(fitted, {"A": 1e-3, "A_down": 1e-3}).each
    assert (both.decision, one_way.decision) == ("not determined", "pass")
    assert keys(both.why) == ["conformity.one_way"] and both.why.endswith(one_way.name)
    assert one_way.name == "A_down_X"


def test_of_one_run_in_each_direction_the_motion_is_judged_by_its_values(reproducible: None) -> None:
    """M has no uncertainty then."""
    once = PRESETS["iso230_2"].model_copy(update={"repeats": 1})
    verdict = of_exx(fit_sessions(simulate(SimulationSpec(plan=once, seed=5)).session), 1e-5)
    assert np.isfinite(verdict.u) and verdict.decision != "not determined"


@pytest.mark.long
def test_one_number_has_one_uncertainty(reproducible: None) -> None:
    """M of ISO 230-2 is the range of EXX."""
    fitted = fit_sessions(simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=5)).session)
    found = conformity(
        fitted, {"EXX": 1e-5, "M_X": 1e-5}, budget=propagate(fitted, template_of("laser_interferometer"))
    )
    motion, mean = found.each
    assert motion == replace(mean, name="EXX")


@pytest.mark.parametrize(
    ("rule", "decisions"),
    [
        # value within and above the tolerance, each with probabilities of 0.99, 0.7, 0.3 and 0.01
        ("guarded", ["pass", "undecided", "undecided", "fail"]),
        ("guarded-acceptance", ["pass", "fail", "fail", "fail"]),
        ("guarded-rejection", ["pass", "pass", "pass", "fail"]),
        ("simple", ["pass", "pass", "fail", "fail"]),
    ],
)
def test_decision_rules(rule: str, decisions: list[str]) -> None:
    cases = [(0.5, 0.99), (0.9, 0.7), (1.1, 0.3), (1.5, 0.01)]
    assert [decide(value, 1.0, probability, rule, 0.95) for value, probability in cases] == decisions


def test_tolerances_as_people_state_them(tmp_path: Path) -> None:
    assert parse_tolerances(["EXX=10um", "C0Y = 20 urad", "ECX=2arcsec", "A_X=0.01mm"]) == pytest.approx(
        {"EXX": 10e-6, "C0Y": 20e-6, "ECX": 2 * np.pi / 648e3, "A_X": 10e-6}
    )
    path = tmp_path / "t.yaml"
    path.write_text("format: mtcal-tolerances/1\ntolerances: {EXX: 10 um, C0Y: 2.0e-5, volumetric: 30um}\n")
    assert read_tolerances(path) == pytest.approx({"EXX": 10e-6, "C0Y": 20e-6, "volumetric": 30e-6})
    path.write_text("format: mtcal-tolerances/1\ntolerances: {EXX: 1e-320}\n")
    with pytest.raises(SessionError, match=r"t.yaml line 2: tolerances.EXX: 9.99989e-321 is too small"):
        read_tolerances(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("EXX", "'EXX' is not of the form NAME=VALUE with a unit"),
        ("EXX=10", "tolerance of EXX: '10' has no unit"),
        ("EXX=ten", "tolerance of EXX: 'ten' is not a number with a unit"),
        ("EXX=10urad", "tolerance of EXX: '10urad' is not of the dimension length"),
        ("C0Y=10um", "tolerance of C0Y: '10um' is not of the dimension angle"),
        ("EXX=10m", "the tolerance of EXX is 10 m, which no machine needs$"),
    ],
)
def test_mistakes_on_the_command_line(text: str, message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        parse_tolerances([text])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("format: mtcal-tolerances/1\ntolerances: {EXX: [1]}\n", "line 2: tolerances.EXX"),
        ("format: mtcal-tolerances/1\ntolerances: {EXX: 3}\nrule: x\n", "line 3: unknown key 'rule'"),
        ("format: mtcal-tolerances/1\ntolerances: {C0Y: 3 um}\n", "C0Y: '3 um' is not of the dimension angle"),
        ("format: mtcal-tolerances/1\ntolerances: {C0Y: 10}\n", "machine needs; a number is in rad: .* as in 10urad"),
    ],
)
def test_mistakes_in_a_file(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "t.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CalibrationError, match=message) as caught:
        read_tolerances(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_two_tolerances_of_one_name() -> None:
    with pytest.raises(ModelError, match="EXX has two tolerances"):
        parse_tolerances(["EXX=1um", "EXX=2um"])


@pytest.mark.parametrize(
    ("tolerances", "said", "message"),
    [
        ({"volum": 1.0}, {}, r"'volum' is no figure with a tolerance \(did you mean 'volumetric'\?\)"),
        ({"EXX": 0.0}, {}, "the tolerance of EXX must be positive, not 0"),
        ({"EXX": 1.0}, {"rule": "strict"}, "no decision rule 'strict'"),
        ({"EXX": 1.0}, {"level": 0.4}, "conformance probability must be between 0.5 and 1, not 0.4"),
    ],
)
def test_wrong_requests(fitted: FittedSessions, tolerances: dict[str, float], said: Any, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        conformity(fitted, tolerances, **said)
