# SPDX-License-Identifier: Apache-2.0
"""What is published of a fit: generalised least squares with what does not reproduce, averaged over its size."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import logsumexp

from machine_tool_calibration.arrays import Array, rms
from machine_tool_calibration.estimation import variance_components
from machine_tool_calibration.estimation.marginal import Gram, LogEvidence, log_noise, noise_variance
from machine_tool_calibration.methods.build import build_model, error_map
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model import marginal_fit
from machine_tool_calibration.model.fit import JointFit, declared, fit_models
from machine_tool_calibration.model.imperfection import imperfection
from machine_tool_calibration.model.model import Kind, Parameter, Term
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.reproducibility import reproducibility
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, Spread, simulate

from .. import plates
from ..line_model import Line

SIGMA = 1e-6
PASSES, PLACES = 6, 8
PLANS = ["tracking_2d", "step_diagonal", "rotary_axis", "probing_cross", "iso230_2", "grid_plate", "straightness"]


SLOPED = Spread(slope=6e-6, bow=6e-6)


def line(columns: dict[str, Array], limit: float | None = None) -> JointFit:
    """A fit of an offset and a scale, where there is a limit of an effect of plausible size."""
    session, n = plates.session(columns, SIGMA, machine={"chain": "w-X-b-t"}), len(columns["x"])
    place, along, zero = (
        np.eye(1, 3) * columns["x"][:, None],
        np.tile(np.eye(1, 3), (n, 1)),
        np.zeros(n, dtype=np.int64),
    )
    observations = Observations(session, session.readings, place, along, 0.0 * along, np.zeros(n), zero)
    scale = Parameter("scale", "1", shared=True)
    if limit is not None:
        scale = Parameter("scale.s", "1", -limit, limit, shared=True, kind=Kind.EFFECT, owner="scale")
    return fit_models([Line(observations, (Term("scale", (scale,), columns["x"][None]),), (), (), (), "none")])


def axis(
    between: float, seed: int = 0, noise: float = 1.0, limit: float | None = None
) -> tuple[JointFit, Array, Array, Array]:
    """A fit of an axis run up and down, and what it is made of, in units of the declared uncertainty.

    Args:
        between: slope of each pass of its own, in standard uncertainties.
        seed: of everything random.
        noise: over that declared.
        limit: of the scale where that is an effect of plausible size.

    Returns:
        The fit, (n, 2) its model, (n, u) columns of what does not reproduce, and (n,) readings.
    """
    rng = np.random.default_rng(seed)
    up = np.linspace(0.0, 0.7, PLACES)
    # The turning points are not measured twice: a pass goes from the place after one turning point to the next.
    # No place is read twice, so that all readings tell the sizes.
    x = np.concatenate([up if k % 2 == 0 else up[::-1] for k in range(PASSES)]) + 1e-6 * np.arange(PASSES * PLACES)
    n = len(x)
    columns = np.column_stack([np.ones(n), x])
    own = np.repeat(rng.normal(size=PASSES), PLACES) * between * np.tile(np.linspace(-1.0, 1.0, PLACES), PASSES)
    reading = SIGMA * (columns @ [3.0, 20.0] + own + noise * rng.normal(size=n))
    fit = line({"x": x, "time": np.arange(n) * 5.0, "displacement": reading}, limit)
    (family,) = reproducibility(fit.assembly.models[0].observations)
    return fit, columns / SIGMA, family.columns().T, reading / SIGMA


@dataclass(frozen=True)
class Generalised:
    """Generalised least squares with an explicit covariance matrix."""

    theta: Array
    covariance: Array
    coefficients: Array
    squares: float
    log_restricted: float


def generalised(model: Array, spread: Array, readings: Array, ratio: float) -> Generalised:
    inverse = np.linalg.inv(np.eye(len(readings)) + ratio**2 * spread @ spread.T)
    normal = model.T @ inverse @ model
    covariance = np.linalg.inv(normal)
    theta = covariance @ model.T @ inverse @ readings
    rest = readings - model @ theta
    determinants = np.linalg.slogdet(inverse)[1] - np.linalg.slogdet(normal)[1]
    return Generalised(
        theta, covariance, ratio**2 * spread.T @ inverse @ rest, float(rest @ inverse @ rest), 0.5 * float(determinants)
    )


def in_declared_units(model: Array, spread: Array, readings: Array, ratio: float) -> float:
    """A size in units of the noise that is found beside it, which is less than declared here."""
    variance = float(noise_variance(generalised(model, spread, readings, ratio).squares, len(readings) - 2))
    assert variance < 1.1
    return float(ratio * np.sqrt(min(variance, 1.0)))


def sizes_tried(monkeypatch: pytest.MonkeyPatch, ratios: Sequence[float]) -> None:
    """Only these, of offsets as of slopes, equally probable."""

    def grid(gram: Gram, log_evidence: LogEvidence, finer: int) -> list[tuple[tuple[float, ...], float, float]]:
        every = [(ratio,) * (int(gram.family.max()) + 1) for ratio in ratios]
        return [(sizes, 0.0, log_evidence(sizes, 0.0)) for sizes in every]

    monkeypatch.setattr(variance_components, "size_grid", grid)


@pytest.mark.parametrize("ratio", [0.0, 0.3, 2.0, 20.0])
def test_a_single_size_is_generalised_least_squares(monkeypatch: pytest.MonkeyPatch, ratio: float) -> None:
    sizes_tried(monkeypatch, [ratio])
    monkeypatch.setattr(marginal_fit, "_ENOUGH", 0)
    monkeypatch.setattr(marginal_fit, "_NUMBERS", 0)  # what few readings leave open of the noise's memory
    fit, model, spread, readings = axis(2.0)
    size = in_declared_units(model, spread, readings, ratio)
    expected = generalised(model, spread, readings, size)
    found = fit.marginal
    assert found.solution.theta[:2] == pytest.approx(expected.theta, rel=1e-9)
    assert found.solution.theta[2:] == pytest.approx(expected.coefficients, rel=1e-7, abs=1e-9)
    assert found.solution.covariance[:2, :2] == pytest.approx(expected.covariance, rel=1e-8)
    assert found.squares == pytest.approx(generalised(model, spread, readings, ratio).squares)
    if ratio:
        # The mixed model's equations (Henderson 1975): all unknowns at once.
        both = np.column_stack([model, spread])
        matrix = both.T @ both + np.diag([0.0, 0.0, *np.full(spread.shape[1], size**-2.0)])
        assert found.solution.covariance == pytest.approx(np.linalg.inv(matrix), rel=1e-6, abs=1e-9)


def test_beside_random_unknowns_all_are_solved_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the mixed model's equations (Henderson 1975); functions whose size is zero are not there."""

    def certain(*given: Any) -> tuple[None, Array, Array]:
        matrix, right = given[4:6]
        return None, np.linalg.solve(matrix, right), np.linalg.inv(matrix)

    monkeypatch.setattr(marginal_fit, "_with_random", certain)
    m, tau = 3, np.array([0.5, 0.0, 2.0])
    columns = np.random.default_rng(1).normal(size=(12, m + 4))
    model = columns[:, :m]
    columns[:, -1] -= model @ np.linalg.lstsq(model, columns[:, -1], rcond=None)[0]  # as a fit leaves it
    total = columns.T @ columns
    problem = SimpleNamespace(size=m)
    mean, covariance, _ = marginal_fit._at(None, None, problem, total, np.diag(total), tau, 1.0)
    there = [0, 1, 2, 3, 5]
    expected = np.linalg.inv(total[np.ix_(there, there)] + np.diag([0.0, 0.0, 0.0, 0.5**-2, 2.0**-2]))
    assert covariance[np.ix_(there, there)] == pytest.approx(expected)
    assert mean[there] == pytest.approx(expected @ total[there, -1])
    assert mean[4] == 0.0 and not covariance[4].any() and not covariance[:, 4].any()


def test_what_is_expected_of_random_unknowns_is_in_the_sum_of_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    """If all reproduces, what is left is what the fit left, its small angles counted as readings of zero."""
    sizes_tried(monkeypatch, [0.0])
    joint = fit_models([build_model(simulate(SimulationSpec(plan=PRESETS["step_diagonal"], seed=3)).session)[0]])
    assert joint.marginal.squares == pytest.approx(joint.solution.chi_square, rel=1e-9)


def test_sizes_are_averaged_over_with_their_probabilities(monkeypatch: pytest.MonkeyPatch) -> None:
    ratios = [0.0, 0.6, 2.0]
    sizes_tried(monkeypatch, ratios)
    fit, model, spread, readings = axis(0.8, seed=3)
    tried = [generalised(model, spread, readings, ratio) for ratio in ratios]
    squares = np.array([one.squares for one in tried])
    logs = np.array([one.log_restricted for one in tried])
    logs += [logsumexp(log_noise(left, len(readings) - 2)) for left in squares]
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    # Otherwise this would say nothing of a mean.
    assert np.sort(weights)[-2] > 0.05
    mean = sum(w * one.theta for w, one in zip(weights, tried, strict=True))
    between = [w * np.outer(one.theta - mean, one.theta - mean) for w, one in zip(weights, tried, strict=True)]
    within = [w * one.covariance for w, one in zip(weights, tried, strict=True)]
    found = fit.marginal
    assert found.solution.theta[:2] == pytest.approx(mean, rel=1e-3)
    expected = found.scatter**2 * sum(within) + sum(between)
    assert fit.published.covariance == pytest.approx(expected, rel=0.02)
    assert found.squares == pytest.approx(weights @ squares, rel=0.02)
    assert found.ratios[0] == pytest.approx(np.sqrt(weights @ np.square(ratios)), rel=1e-3)


def test_readings_that_scatter_more_than_declared_widen_what_is_published(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes_tried(monkeypatch, [0.5])
    monkeypatch.setattr(marginal_fit, "_ENOUGH", 0)
    monkeypatch.setattr(marginal_fit, "_NUMBERS", 0)
    fit, model, spread, readings = axis(0.0, noise=3.0)
    expected = generalised(model, spread, readings, 0.5)
    factor = np.sqrt(expected.squares / (len(readings) - 2))
    assert factor > 2.0
    # What was declared still says a little.
    assert 0.9 * factor < fit.marginal.scatter < 1.02 * factor
    size = np.sqrt(np.diag(expected.covariance))
    covariance = fit.published.covariance / fit.marginal.scatter**2 / np.outer(size, size)
    assert covariance == pytest.approx(expected.covariance / np.outer(size, size), rel=0.02)
    # What is known of an effect's size beforehand is weighed against that scatter.
    limited = axis(0.0, noise=3.0, limit=100.0 * SIGMA)[0]
    assert np.diag(limited.published.covariance) == pytest.approx(np.diag(fit.published.covariance), rel=0.05, abs=0.0)


def test_an_effect_of_plausible_size_is_what_the_readings_say_and_one_beyond_it_is_drawn_to_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sizes_tried(monkeypatch, [0.5])
    monkeypatch.setattr(marginal_fit, "_ENOUGH", 0)
    monkeypatch.setattr(marginal_fit, "_NUMBERS", 0)
    fit, model, spread, readings = axis(0.0, limit=100.0 * SIGMA)
    expected = generalised(model, spread, readings, in_declared_units(model, spread, readings, 0.5))
    known = fit.marginal.scatter**2 * expected.covariance
    assert (np.abs(fit.published.theta[:2] - expected.theta) < 0.3 * np.sqrt(np.diag(known))).all()
    assert fit.published.covariance == pytest.approx(known, rel=0.05)
    # With a limit of a hundredth of what is read only the rare larger size is left: a hundred times the limit.
    narrow = axis(0.0, limit=0.2 * SIGMA)[0].published
    own = np.sqrt(fit.published.covariance[1, 1])
    assert 0.0 < expected.theta[1] - narrow.theta[1] < 6.0 * own
    # The offset moves with it as the readings say that it must.
    moved = narrow.theta[:2] - expected.theta
    assert moved[0] / moved[1] == pytest.approx(expected.covariance[0, 1] / expected.covariance[1, 1], rel=1e-6)


def test_each_family_has_a_size_in_metres() -> None:
    """The root mean square of what was put in: of the passes of an axis, and of mountings beside runs."""
    (passes,) = axis(6.0, seed=1)[0].marginal.sizes
    slopes = 6.0 * SIGMA * np.random.default_rng(1).normal(size=PASSES)
    own = np.sqrt(np.mean(slopes**2) * np.mean(np.linspace(-1.0, 1.0, PLACES) ** 2))
    assert passes.size == pytest.approx(own, rel=0.3)
    assert passes.low < own < passes.high
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=3, spread=Spread(slope=3e-6, bow=3e-6))
    runs, mountings = fit_models([build_model(simulate(spec).session)[0]]).marginal.sizes
    assert (runs.name, mountings.name) == ("run", "mounting")
    # A slope from -1 to 1 and a parabola 1, -1/2, 1 over each mounting.
    assert mountings.low < 3e-6 * np.sqrt(1 / 3 + 1 / 5) < mountings.high
    assert runs.high < mountings.low


def test_each_sessions_functions_have_their_own_coefficients() -> None:
    """Two axes that share their scale: what a pass has of its own is that session's, in the order of the sessions."""
    own = [axis(4.0, seed=seed)[0].assembly.models[0] for seed in (1, 2)]
    joint = fit_models(own, ["a", "b"])
    found = joint.marginal
    first, second = found.coefficients(0), found.coefficients(1)
    count = len(found.solution.theta)
    assert np.concatenate([first, second]).tolist() == list(range(count - len(first) - len(second), count))
    assert len(first) == len(found.functions[0]) > PASSES


def test_scatter_grows_without_a_jump() -> None:
    """No test decides beforehand whether the readings' scatter counts."""
    chi_square = np.linspace(0.0, 100.0, 400)
    scatter = np.array([marginal_fit._scatter(value, 10) for value in chi_square])
    assert (np.diff(scatter) >= 0.0).all()
    assert np.diff(scatter).max() < 0.05
    assert scatter[0] == 1.0
    assert scatter[-1] == pytest.approx(np.sqrt(10.0), rel=0.1)


@pytest.mark.long(but=("tracking_2d", "probing_cross"))
@pytest.mark.parametrize("plan", PLANS)
def test_a_declared_uncertainty_three_times_too_small_is_corrected(plan: str) -> None:
    """In every method, to what chance allows; and one too large makes nothing better."""
    for factor in (3.0, 1 / 3):
        session = simulate(SimulationSpec(plan=PRESETS[plan], seed=3, noise_factor=factor)).session
        fit = fit_models([build_model(session)[0]])
        if factor < 1:
            assert fit.marginal.scatter == 1.0
        else:
            chance = 4.0 / np.sqrt(2.0 * fit.solution.degrees_of_freedom)
            assert fit.marginal.scatter == pytest.approx(3.0, rel=chance)


@pytest.mark.parametrize(
    ("plan", "quantity"), [("tracking_2d", "position_error"), ("probing_cross", "workpiece_error")]
)
def test_spread_between_mountings_is_found_and_in_the_maps_uncertainty(plan: str, quantity: str) -> None:
    uncertainty, chance = [], []
    for size in (0.0, 4.0):
        sigma = simulate(SimulationSpec(plan=PRESETS[plan], seed=3)).session.sigma
        spread = Spread(slope=size * sigma, bow=size * sigma)
        fit = fit_models([build_model(simulate(SimulationSpec(plan=PRESETS[plan], seed=3, spread=spread)).session)[0]])
        own = fit.fits[0]
        published = np.asarray(error_map(own).content[f"{quantity}_u"], dtype=float)
        uncertainty.append(float(np.sqrt(np.nanmean(published**2))))
        chance.append(max(size.probability for size in fit.marginal.sizes))
        # What does not reproduce is no scatter of single readings.
        assert fit.marginal.scatter < 1.3
    assert chance[0] < 0.5 < 0.99 < chance[1]
    assert uncertainty[1] > 1.4 * uncertainty[0]


@pytest.mark.parametrize("plan", ["tracking_2d", "tracking_3d"])
def test_what_a_model_lacks_is_no_spread_where_readings_were_repeated(plan: str) -> None:
    """A misfit that is the same in every repeat neither looks like a spread nor moves the map; a real spread does."""
    session = simulate(SimulationSpec(plan=PRESETS[plan], seed=5)).session
    readings = session.readings
    setup = np.cos(7.0 * readings.position().sum(axis=1) / 0.5 + 2.0 * readings.setup)
    for lacking in (0.0, 8.0):
        change = lacking * session.sigma * setup
        moved = session.with_readings(replace(readings, displacement=readings.displacement + change))
        joint = fit_models([build_model(moved)[0]])
        assert max(size.size for size in joint.marginal.sizes) < session.sigma
        own, plain = joint.fits[0], declared(joint).fits[0]
        difference = error_map(own).error - error_map(plain).error
        uncertainty = error_map(own).uncertainty
        assert np.sqrt(np.nanmean((difference / uncertainty) ** 2)) < 0.3
    spread = Spread(slope=8.0 * session.sigma, bow=8.0 * session.sigma)
    found = fit_models([build_model(simulate(SimulationSpec(plan=PRESETS[plan], seed=5, spread=spread)).session)[0]])
    assert max(size.size for size in found.marginal.sizes) > 1.5 * session.sigma


def test_what_a_model_lacks_moves_no_map_where_nothing_was_repeated() -> None:
    """Backlash leaves more than runs that differ can explain; runs that do differ move the map to where it belongs."""
    for flaw, moves in (({"effects": (FlawSpec(id="backlash_y", amplitude=3e-6),)}, False), ({"spread": SLOPED}, True)):
        session = simulate(SimulationSpec(plan=PRESETS["probing_cross"], seed=5, **flaw)).session
        joint = fit_models([build_model(session)[0]])
        assert max(size.size for size in joint.marginal.sizes) > 0.5 * session.sigma
        at = slice(0, len(joint.solution.theta))
        assert np.allclose(joint.published.theta, joint.solution.theta, rtol=1e-9, atol=1e-12) != moves
        # What does not move the map widens it by all that runs may differ.
        own, widened = np.diag(joint.solution.covariance), np.diag(joint.marginal.solution.covariance[at, at])
        assert (np.median(widened[own > 0.0] / own[own > 0.0]) > 1.5) != moves


@pytest.mark.parametrize("most", [20_000, 300])
def test_places_that_differ_more_than_their_repeats_count_as_many_as_they_are(
    most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each place of an axis is read eight times in a row: its own error is not averaged by that."""
    monkeypatch.setattr("machine_tool_calibration.model.reproducibility._ENOUGH", most)
    rng = np.random.default_rng(1)
    x, own = np.linspace(0.0, 1.0, 100), 3.0 * SIGMA * rng.normal(size=100)

    def uncertainty(times: int) -> Array:
        read = np.repeat(own, times) + SIGMA * rng.normal(size=100 * times)
        fit = line({"x": np.repeat(x, times), "displacement": read})
        return np.asarray(np.sqrt(np.diag(fit.published.covariance)))

    assert uncertainty(8) == pytest.approx(uncertainty(1), rel=0.15)


@pytest.mark.parametrize("plan", ["tracking_2d", "rotary_axis"])
def test_what_every_model_lacks_widens_the_map_by_as_much_as_it_moves_it(
    plan: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Smooth functions of place, the same in every repeat, of three standard uncertainties together."""
    session = simulate(SimulationSpec(plan=PRESETS[plan], seed=5)).session
    shapes = imperfection(build_model(session)[0].observations)

    def found(size: float) -> tuple[Array, Array]:
        change = size * session.sigma * np.random.default_rng(2).normal(size=len(shapes)) @ shapes
        readings = replace(session.readings, displacement=session.readings.displacement + change)
        error_of = error_map(fit_models([build_model(session.with_readings(readings))[0]]).fits[0])
        return error_of.error, error_of.uncertainty

    (sound, _), (moved, uncertainty) = found(0.0), found(3.0)
    seen = uncertainty > 0
    assert 0.3 < rms((moved - sound)[seen] / uncertainty[seen]) < 1.5
    # Of more readings than this it is left out, and scatter alone says too little.
    monkeypatch.setattr(marginal_fit, "_ENOUGH", len(session.readings) - 1)
    assert rms(uncertainty[seen]) > 1.3 * rms(found(3.0)[1][seen])


def test_what_every_model_lacks_is_no_larger_for_being_read_again() -> None:
    """Places differ by eight times the noise: each is read twice, or sixteen times."""
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=5)).session
    place = build_model(session)[0].observations.place
    change = 8.0 * session.sigma * np.random.default_rng(2).normal(size=place.max() + 1)[place]

    def uncertainty(times: int) -> Array:
        own, n = session.readings, len(session.readings)
        every = own.select(np.tile(np.arange(n), times))
        noise = session.sigma * np.random.default_rng(3).normal(size=n * times)
        read = np.tile(own.displacement + change, times) + noise
        repeat = every.repeat + np.repeat(np.arange(times), n) * (own.repeat.max() + 1)
        fit = fit_models([build_model(session.with_readings(replace(every, displacement=read, repeat=repeat)))[0]])
        return error_map(fit.fits[0]).uncertainty[:, :2]

    assert rms(uncertainty(8)) == pytest.approx(rms(uncertainty(1)), rel=0.2)


def test_a_memory_adds_no_more_than_it_does_to_a_constant_however_large_the_spread() -> None:
    """Rows that differ and a form that the model lacks: U of a drift had been up to eight times too large."""
    rng, rows, count = np.random.default_rng(0), 20, 44
    at = np.concatenate([np.linspace(0.0, 1.0, 4), np.linspace(0.1, 0.9, count - 4)])
    x, row = np.tile(at, rows), np.repeat(np.arange(rows), count)
    y = np.where(np.tile(np.arange(count) < 4, rows), 0.0, 0.05 + 0.45 * row / (rows - 1))
    drift, form = 4e-9, 4.8e-6 * (x - 0.5) * (y - 0.25)
    columns = {"time": 1.0 * np.arange(len(x)), "x": x, "y": y, "gz": 1.0}
    noise = 2.5e-7 * rng.normal(size=len(x)) + 3.5e-7 * rng.normal(size=rows)[row]
    columns["displacement"] = form + drift * columns["time"] + noise
    session = plates.session(columns, 3e-7, "rigid", (), row, repeats=rows)
    found = identify(session, effects=["linear_drift"])
    assert 1.0 < found.document()["memory_factor"] < 2.0
    (rate,) = (one for one in found.parameters if one.name == "linear_drift.r")
    assert abs(rate.value - drift) < 3.0 * rate.standard_uncertainty < 0.3 * drift
