# SPDX-License-Identifier: Apache-2.0
"""Budgets of which every number is known otherwise: in closed form, from the fit's covariance, by random draws."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.budget import propagate as module
from machine_tool_calibration.budget.contributor import instruments, template_of
from machine_tool_calibration.budget.propagate import KNOWN, REPEATABILITY, Budget, propagate
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.fitted import FitRequest, FittedSessions, fit_sessions
from machine_tool_calibration.model.fit import changed, declared
from machine_tool_calibration.session.contributor import Contributor
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import DiagonalPlan, RotaryPlan, SimulationSpec, TrackingPlan, simulate

X = np.array([0.0, 0.1, 0.2, 0.3, 0.4])


def exx(budget: Budget, line: int = 0) -> np.ndarray:
    """Standard uncertainty of EXX at its nodes from one contributor, µm."""
    return 1e6 * budget.lines[line].u[budget.numbers.quantity("EXX").members]


@pytest.mark.parametrize(
    ("enters", "varies", "expected"),
    [
        ("reading", "reading", 2.0 / 2.0),
        ("along", "run", 2.0 / 2.0),
        ("reading", "setup", 2.0),
        ("reading", "place", 2.0),
        ("reading", "angle", 2.0),
        ("reading", "session", 2.0),
        ("length", "never", 2.0 * X),
        ("length", "run", X),
        ("length", "reading", X),
        ("length", "place", 2.0 * X),
    ],
)
def test_runs_along_an_axis(
    fitted: FittedSessions, contributor: Callable[..., Contributor], enters: str, varies: str, expected: Any
) -> None:
    """The mean of four runs: what the runs share stays, what each has for itself is halved, a length error is a slope.

    What every reading has for itself in proportion to its length is not what the fit weighs it by, and exact all the
    same.
    """
    budget = propagate(fitted, [contributor(enters, varies)])
    assert exx(budget) == pytest.approx(np.broadcast_to(expected, 5), rel=1e-6, abs=1e-9)
    assert budget.lines[0].reading == pytest.approx(2e-6 * (0.4 if enters == "length" else 1.0))


def test_expansion_and_air(fitted: FittedSessions, contributor: Callable[..., Contributor]) -> None:
    """By its coefficient of expansion; by Edlén's equation 0.93 µm/(m K), 0.27 µm/m per hPa, 0.85 µm/m for all the
    difference between dry and humid air at 20 °C."""
    lines = [
        contributor("temperature", "never", 0.5, expansion=11.5e-6),
        contributor("air_temperature", "never", 1.0),
        contributor("air_pressure", "never", 100.0),
        contributor("air_humidity", "never", 1.0),
    ]
    budget = propagate(fitted, lines)
    assert exx(budget, 0) == pytest.approx(5.75 * X, abs=1e-9)
    assert [exx(budget, k)[-1] / 0.4 for k in (1, 2, 3)] == pytest.approx([0.93, 0.27, 0.85], rel=0.03)


@pytest.mark.parametrize(("distribution", "fourth"), [("normal", 3.0), ("rectangular", 1.8)])
def test_cosine_error_of_an_angle(
    fitted: FittedSessions, contributor: Callable[..., Contributor], distribution: str, fourth: float
) -> None:
    """L phi^2 / 2: its root mean square is that of the fourth moment, and its mean all values have in common."""
    one = propagate(fitted, [contributor("angle", "setup", 2e-3, distribution=distribution)])
    assert exx(one) == pytest.approx(1e6 * X / 2.0 * 4e-6 * np.sqrt(fourth), abs=1e-9)
    each = propagate(fitted, [contributor("angle", "run", 2e-3, distribution=distribution)])
    assert exx(each) == pytest.approx(1e6 * X / 2.0 * 4e-6 * np.sqrt(1.0 + (fourth - 1.0) / 4.0), abs=1e-9)


def test_across_the_beam(fitted: FittedSessions, contributor: Callable[..., Contributor]) -> None:
    """e^2 / (2 L): 0.8 mm at 0.32 m are 1.0 µm, as Ibaraki et al. 2014, Section 4.3, have it."""
    budget = propagate(fitted, [contributor("across", "never", 0.8e-3, distribution="arcsine")])
    assert exx(budget)[1:] == pytest.approx(1e6 * 0.64e-6 / 2.0 / X[1:] * np.sqrt(1.5))
    at_320 = exx(budget)[3] / np.sqrt(1.5) * 0.3 / 0.32
    assert at_320 == pytest.approx(1.0)


def test_sum_degrees_of_freedom_and_coverage(fitted: FittedSessions, contributor: Callable[..., Contributor]) -> None:
    lines = [
        contributor("reading", "setup", degrees_of_freedom=5.0),
        contributor("along", "setup", degrees_of_freedom=10.0),
    ]
    found = propagate(fitted, lines).largest("EXX")
    assert found is not None
    assert found.u == pytest.approx(2e-6 * np.sqrt(2.0))
    assert [part.share for part in found.shares] == pytest.approx([0.5, 0.5])
    # (u1^2 + u2^2)^2 / (u1^4 / 5 + u2^4 / 10), and Student's t of 95.45 %: tabulated are 2.20 (13), 2.18 (14).
    assert found.degrees_of_freedom == pytest.approx(4.0 / 0.3)
    assert found.k == pytest.approx(2.20, abs=0.02)
    without = propagate(fitted, [contributor("reading", "setup")]).largest("EXX")
    assert without is not None and without.k == 2.0 and np.isinf(without.degrees_of_freedom)


def test_every_number_has_degrees_of_freedom_of_its_own(
    fitted: FittedSessions, contributor: Callable[..., Contributor]
) -> None:
    """The error of length, 2 µm/m, adds to the 2 µm of a setup the more, the farther from the start."""
    lines = [
        contributor("reading", "setup", degrees_of_freedom=5.0),
        contributor("length", "never", degrees_of_freedom=10.0),
    ]
    budget = propagate(fitted, lines)
    members = budget.numbers.quantity("EXX").members
    expected = (1.0 + X**2) ** 2 / (1.0 / 5.0 + X**4 / 10.0)
    np.testing.assert_allclose(budget.degrees_of_freedom[members], expected)
    assert np.all(budget.expanded[members] > 2.0 * budget.complete[members])


def test_rms_over_a_quantity(fitted: FittedSessions, contributor: Callable[..., Contributor]) -> None:
    budget = propagate(fitted, [contributor("length", "never")])
    found = budget.rms("EXX")
    assert found is not None
    assert found.u == pytest.approx(2e-6 * np.sqrt(np.mean(X**2)))
    stated = budget.numbers.u[budget.numbers.quantity("EXX").members]
    assert found.u_identification == pytest.approx(np.sqrt(np.mean(stated**2)))


@pytest.mark.long
def test_monte_carlo_agrees(fitted: FittedSessions, contributor: Callable[..., Contributor]) -> None:
    """Within four standard deviations of its own chance; the interval of a rectangular distribution ends before 2 u."""
    lines = [contributor("length", "never", distribution="rectangular"), contributor("reading", "run", 1e-8)]
    budget = propagate(fitted, lines, draws=300)
    assert budget.drawn is not None
    members = budget.numbers.quantity("EXX").members
    ratio = budget.drawn.u[members] / budget.u[members]
    assert np.abs(ratio - 1.0).max() < 4.0 / np.sqrt(2.0 * 300)
    # 95 % of a rectangular distribution are 0.95 sqrt(3) standard uncertainties on either side.
    low, high = budget.drawn.interval(members.stop - 1)
    assert [low, high] == pytest.approx([-0.8e-6 * 1.645, 0.8e-6 * 1.645], rel=0.1)


def test_declared_uncertainty_gives_what_is_published(
    reproducible: None, contributor: Callable[..., Contributor]
) -> None:
    """Readings as uncertain as declared, each by itself: the published uncertainty of every number."""
    session = simulate(SimulationSpec(plan=TrackingPlan(dimension=2), seed=3)).session
    own = fit_sessions(session)
    budget = propagate(own, [contributor("reading", "reading", session.sigma)])
    known = np.isfinite(budget.u) & (budget.numbers.u > 1e-12)
    assert own.joint.marginal.scatter == 1.0
    assert budget.u[known] == pytest.approx(budget.numbers.u[known], rel=1e-9)
    assert budget.lines[0].how == "closed form"


def test_repeats_in_closed_form_are_as_one_by_one(
    monkeypatch: pytest.MonkeyPatch, contributor: Callable[..., Contributor]
) -> None:
    session = simulate(SimulationSpec(plan=TrackingPlan(dimension=2), seed=3)).session
    own = fit_sessions(session)
    line = contributor("along", "angle")
    closed = propagate(own, [line])
    monkeypatch.setattr(module, "_MOST_GROUPS", 1000)
    steps = propagate(own, [line])
    assert (closed.lines[0].how, steps.lines[0].how) == ("closed form", "steps")
    for name in ("position_error", "stations"):
        members = closed.numbers.quantity(name).members
        assert closed.u[members] == pytest.approx(steps.u[members], rel=1e-5, nan_ok=True)


@pytest.mark.long
def test_draws_and_bounds(monkeypatch: pytest.MonkeyPatch, contributor: Callable[..., Contributor]) -> None:
    """Where places are too many to go through, draws are near the exact sum, and a bound is above it."""
    session = simulate(SimulationSpec(plan=TrackingPlan(dimension=2), seed=3)).session
    own = fit_sessions(session)
    line = contributor("length", "place")
    exact = propagate(own, [line])
    monkeypatch.setattr(module, "_MOST_GROUPS", 10)
    drawn = propagate(own, [line])
    monkeypatch.setattr(module, "_NEGLIGIBLE_SHARE", np.inf)
    bound = propagate(own, [line])
    assert [b.lines[0].how for b in (exact, drawn, bound)] == ["steps", "draws", "bound"]
    members = exact.numbers.quantity("position_error").members
    ratio = drawn.u[members] / exact.u[members]
    assert np.nanmean(ratio) == pytest.approx(1.0, abs=0.05)
    assert np.nanmin(bound.u[members] / exact.u[members]) > 1.0


@pytest.mark.long
def test_what_is_known_besides_the_readings() -> None:
    """Readings and what is expected of angular errors together make the declared uncertainty, each by itself found by
    shifting it."""
    own = fit_sessions(simulate(SimulationSpec(plan=DiagonalPlan(blocks=3), seed=1)).session)
    priors = own.joint.assembly.problem.priors
    assert priors is not None
    budget = propagate(
        own, [Contributor(name="r", type="B", standard_uncertainty=1e-7, enters="reading", varies="run")]
    )
    known = next(line for line in budget.lines if line.name == KNOWN)
    still = [np.zeros(len(model.observations)) for model in own.joint.assembly.models]
    base = own.map_of(changed(own.joint, still)).error
    squares = np.zeros_like(base)
    for k, sigma in enumerate(priors.sigma):
        shift = np.zeros(len(priors.sigma))
        shift[k] = sigma
        squares += (own.map_of(changed(own.joint, still, shift)).error - base) ** 2
    found = known.u[budget.numbers.quantity("position_error").members].reshape(base.shape)
    total = own.map_of(declared(own.joint)).uncertainty
    assert np.nanmax(found) > 1e-8
    assert found == pytest.approx(np.sqrt(squares), rel=1e-6, abs=1e-13, nan_ok=True)
    assert not (found > total * (1.0 + 1e-9)).any()


def test_figures_of_iso_230_2(runs: Callable[..., Session], contributor: Callable[..., Contributor]) -> None:
    """A length error of 2 µm/m over 0.4 m changes the range M by 0.8 µm; an offset changes none; runs scatter."""
    there = np.concatenate([X, X[::-1]])
    session = runs(runs=4)
    readings = session.readings
    n = len(readings)
    rng = np.random.default_rng(1)
    sense = np.where(np.arange(n) // 5 % 2 == 0, 1.0, -1.0)
    columns = {**readings.columns, "x": np.tile(there, 2), "dir_x": sense}
    deviation = 20e-6 * columns["x"] + 1e-6 * sense + 1e-7 * rng.standard_normal(n)
    readings = type(readings)(readings.setup, readings.repeat // 2, deviation, columns, readings.labels, readings.row)
    own = fit_sessions(session.with_readings(readings))
    budget = propagate(own, [contributor("length", "never"), contributor("reading", "setup")])
    length, offset, repeatability = budget.lines
    assert repeatability.name == REPEATABILITY
    m = budget.numbers.quantity("M_X").first
    assert length.u[m] == pytest.approx(0.8e-6, rel=1e-6)
    assert offset.u[m] == pytest.approx(0.0, abs=1e-15)
    assert repeatability.u[m] == pytest.approx(budget.numbers.u[m])
    assert budget.u[m] == pytest.approx(np.hypot(0.8e-6, budget.numbers.u[m]), rel=1e-6)


def both_ways(session: Session, deviation: np.ndarray) -> FittedSessions:
    """Two runs up and down over the five positions, with these deviations."""
    readings = session.readings
    sense = np.where(np.arange(20) // 5 % 2 == 0, 1.0, -1.0)
    columns = {**readings.columns, "x": np.tile(np.concatenate([X, X[::-1]]), 2), "dir_x": sense}
    moved = type(readings)(readings.setup, readings.repeat // 2, deviation, columns, readings.labels, readings.row)
    return fit_sessions(session.with_readings(moved))


def test_a_range_is_as_uncertain_whichever_end_is_the_larger(
    runs: Callable[..., Session], contributor: Callable[..., Contributor]
) -> None:
    """One way or the other a length makes a range larger: the same machine seen from its other end has the same U."""
    shape = 1e-6 * np.array([0.0, 2.0, 0.5, 1.9, 0.3])
    scatter = 1e-8 * np.random.default_rng(3).standard_normal(20)
    u = []
    for sign in (1.0, -1.0):
        deviation = sign * np.tile(np.concatenate([shape, shape[::-1]]), 2) + scatter
        budget = propagate(both_ways(runs(), deviation), [contributor("length", "never", 4e-6)])
        u.append([budget.lines[0].u[budget.numbers.quantity(f"{name}_X").first] for name in ("M", "E", "A_up")])
    assert u[0] == pytest.approx(u[1], rel=0.05)
    assert min(u[0]) > 0.3e-6


@pytest.mark.long
def test_what_the_runs_scatter_is_counted_once(
    runs: Callable[..., Session], contributor: Callable[..., Contributor]
) -> None:
    """Repeatability and drift from run to run are in the figures' scatter already, drawn or not."""
    own = both_ways(runs(), 1e-6 * np.random.default_rng(3).standard_normal(20))
    lines = [contributor("reading", "reading", 1e-6), contributor("reading", "run", 1e-6)]
    budget = propagate(own, lines, draws=400)
    for name in ("R_X", "A_X", "M_X"):
        k = budget.numbers.quantity(name).first
        assert budget.u[k] == pytest.approx(budget.numbers.u[k])
        assert budget.drawn is not None and budget.drawn.u[k] == pytest.approx(budget.u[k], rel=0.12)


@pytest.mark.parametrize("instrument", instruments())
def test_budgets_to_begin_with_name_their_sources(instrument: str) -> None:
    lines = template_of(instrument)
    assert all(line.source for line in lines)
    assert len({line.name for line in lines}) == len(lines)


def test_radial_error_motion_dominates_the_open_loop_interferometer() -> None:
    """As Ibaraki et al. 2014 conclude from Table 4: the directions of the beam contribute next to nothing."""
    own = fit_sessions(simulate(SimulationSpec(plan=TrackingPlan(dimension=2), seed=3)).session)
    budget = propagate(own, template_of("tracking_interferometer"))
    found = budget.largest("position_error")
    assert found is not None
    share = {
        line.contributor.symbol: part.share
        for line, part in zip(budget.lines, found.shares, strict=True)
        if line.contributor
    }
    assert share["u_21"] > 0.9
    assert sum(share[name] for name in ("u_3", "u_41", "u_42", "u_43", "u_44")) < 1e-3


def test_what_is_not_there(fitted: FittedSessions, contributor: Callable[..., Contributor]) -> None:
    budget = propagate(fitted, [contributor("reading", "run")])
    with pytest.raises(ModelError, match=r"'EXXX' is not published of this measurement \(did you mean 'EXX'\?\)"):
        budget.largest("EXXX")
    with pytest.raises(ModelError, match="is of a laser_tracker, and no instrument that is named read this"):
        propagate(fitted, [contributor("reading", "run", instrument="laser_tracker")])
    with pytest.raises(ModelError, match="do not fit into memory; at most"):
        propagate(fitted, [contributor("reading", "run")], draws=10**8)


def test_of_two_sessions_one_instrument(
    reproducible: None, runs: Callable[..., Session], contributor: Callable[..., Contributor]
) -> None:
    """EXX is the mean weighted by the declared uncertainties, 1 µm and 2 µm: four fifths of it are the first one's."""
    first = runs(instrument="laser_interferometer")
    second = runs(instrument="cmm", standard_uncertainty={"displacement": 2e-6})
    own = fit_sessions(FitRequest((first, second), ("a", "b")))
    lines = [
        contributor("reading", "reading", instrument="laser_interferometer"),
        contributor("reading", "setup", instrument="cmm"),
        contributor("length", "never"),
        contributor("reading", "place", instrument="laser_interferometer"),
    ]
    budget = propagate(own, lines)
    assert exx(budget, 3) == pytest.approx(np.full(5, 0.8 * 2.0))
    assert exx(budget, 0) == pytest.approx(np.full(5, 0.8 * 2.0 / 2.0))
    assert exx(budget, 1) == pytest.approx(np.full(5, 0.2 * 2.0))
    assert exx(budget, 2) == pytest.approx(2.0 * X, abs=1e-9)


@pytest.mark.long
def test_the_axis_average_line_knows_how_sure_the_stations_are() -> None:
    """Where the stations are stated to be is a line of the budget, once, and in the draws as well."""
    own = fit_sessions(simulate(SimulationSpec(plan=RotaryPlan(), seed=1)).session)
    line = Contributor(name="r", type="B", standard_uncertainty=1e-7, enters="reading", varies="reading")
    budget = propagate(own, [line], draws=100)
    assert budget.drawn is not None
    assert [one.name for one in budget.lines] == ["r", KNOWN]
    for name in ("X0C", "A0C"):
        index = budget.numbers.quantity(name).first
        assert budget.lines[1].u[index] > 0.0
        # Four standard deviations of the chance of 100 draws.
        assert budget.drawn.u[index] / budget.u[index] == pytest.approx(1.0, abs=4.0 / np.sqrt(200.0))
    assert budget.lines[1].u[budget.numbers.quantity("EXC").members] == pytest.approx(np.zeros(18), abs=1e-12)


def test_sessions_with_other_numbers_of_repeats(
    reproducible: None,
    monkeypatch: pytest.MonkeyPatch,
    runs: Callable[..., Session],
    contributor: Callable[..., Contributor],
) -> None:
    """A value for each place of a session: as many readings share it as the session has repeats."""
    own = fit_sessions(FitRequest((runs(runs=2), runs(runs=8)), ("a", "b")))
    line = contributor("along", "place")
    steps = propagate(own, [line])
    monkeypatch.setattr(module, "_MOST_GROUPS", 0)
    closed = propagate(own, [line])
    assert (steps.lines[0].how, closed.lines[0].how) == ("steps", "closed form")
    # Two readings of ten and eight of ten: weights of 0.2 and 0.8.
    assert exx(steps) == pytest.approx(np.full(5, 2.0 * np.hypot(0.2, 0.8)))
    assert exx(closed) == pytest.approx(exx(steps))
