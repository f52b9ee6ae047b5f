# SPDX-License-Identifier: Apache-2.0
"""The comparison of a model with its readings: figures against hand counts, statistics, and known faults."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from machine_tool_calibration.diagnosis.compare import Comparison, compare
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import JointFit, fit_models
from machine_tool_calibration.reports.comparison import comparison_document, comparison_tables, in_words
from machine_tool_calibration.reports.identification import goodness_of_fit
from machine_tool_calibration.residuals.covariates import bins, covariates
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, Chips, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.words import say

from .. import plates
from ..cube import CUBE

PLANS = ["tracking_2d", "tracking_3d", "step_diagonal", "rotary_axis", "probing_cross", "iso230_2"]


def simulated(plan: str, seed: int = 3, *flaws: FlawSpec, **changes: object) -> Session:
    chosen = CUBE if plan == "tracking_3d" else PRESETS[plan]
    return simulate(SimulationSpec(plan=chosen, seed=seed, effects=flaws, **changes)).session  # type: ignore[arg-type]


@cache
def compared(plan: str) -> Comparison:
    """A comparison that several tests look at."""
    return compare(simulated(plan))


def moved(session: Session, change: np.ndarray) -> Session:
    readings = session.readings
    return session.with_readings(replace(readings, displacement=readings.displacement + change))


@pytest.mark.parametrize("plan", PLANS)
def test_the_figures_are_those_of_the_residuals(plan: str) -> None:
    found = compared(plan)
    fit, readings = found.fit, found.fit.model.observations.readings
    assert found.overall.rms_residual == pytest.approx(np.sqrt(np.mean(fit.residuals**2)))
    for parts in (found.setups, found.runs):
        assert parts["share"].sum() == pytest.approx(1.0)
        assert parts["readings"].sum() == len(readings)
        assert parts["reduced_chi_square"].fillna(0.0).is_monotonic_decreasing
    for share in found.setups.itertuples():
        mine = readings.setup == found.fit.model.observations.session.setup_ids.index(share.name)
        assert share.rms == pytest.approx(np.sqrt(np.mean(fit.residuals[mine] ** 2)))
        if np.isfinite(share.mean):
            assert share.mean == pytest.approx(fit.residuals[mine].mean(), abs=1e-3 * found.noise.declared)
        if np.isfinite(share.slope):
            slope = np.polyfit(readings.column("time")[mine], fit.residuals[mine], 1)[0]
            assert share.slope == pytest.approx(slope, rel=1e-3, abs=1e-3 * share.slope_u)
    for way in found.approaches.itertuples():
        sense = readings.column(f"dir_{way.axis}")
        assert (way.forward, way.backward) == (np.sum(sense > 0), np.sum(sense < 0))
        if np.isfinite(way.difference):
            apart = fit.residuals[sense > 0].mean() - fit.residuals[sense < 0].mean()
            assert way.difference == pytest.approx(apart, abs=1e-3 * found.noise.declared)


@pytest.mark.long(but=("tracking_2d", "rotary_axis"))
@pytest.mark.parametrize("plan", PLANS)
def test_every_reading_has_a_scatter_of_one_if_the_model_is_right(plan: str) -> None:
    squares, free = [], 0
    for seed in range(5, 7):
        found = compare(simulated(plan, seed))
        squares.append(np.mean(found.residuals["studentized"] ** 2))
        free += found.overall.degrees_of_freedom
    # To three standard deviations of a mean of so many squares.
    assert np.mean(squares) == pytest.approx(1.0, abs=3.0 * np.sqrt(2.0 / free))


def test_what_the_model_takes_up_is_no_number() -> None:
    """Every station has a free dead path: the mean of its residuals is zero whatever was read."""
    found = compared("tracking_2d")
    assert found.setups[["mean", "mean_u"]].isna().all(axis=None)


def test_a_good_model_is_said_to_fit() -> None:
    words = in_words(compared("tracking_2d"))
    assert words.startswith("The model fits the readings within their declared uncertainty (p = ")


def test_a_bad_setup_is_named() -> None:
    session = simulated("tracking_2d")
    readings = session.readings
    wave = 4e-6 * np.sin(readings.column("time") / 40.0) * (readings.setup == 2)
    found = compare(moved(session, wave))
    assert found.setups["name"][0] == "C"
    assert "Worst is setup C" in in_words(found)
    assert found.overall.p_value < 1e-6


def test_a_reversal_is_no_fault_of_the_model_of_a_run_by_iso_230_2() -> None:
    """The sentence is that of the identification: what is measured against another is said in one place."""
    found = identify(simulated("iso230_2", 5, FlawSpec(id="backlash_x", size=2e-6)))
    words = in_words(compare(found))
    assert words.startswith(goodness_of_fit(found.document())) and "part of the result (ISO 230-2)" in words
    assert "lacks something" not in words and "diagnosis" not in words


@pytest.mark.parametrize(("plan", "axis"), [("tracking_3d", "y"), ("rotary_axis", "c"), ("iso230_2", "x")])
def test_backlash_shows_as_a_displacement_of_twice_its_half_width(plan: str, axis: str) -> None:
    size = 20e-6 if axis == "c" else 2e-6
    found = compare(simulated(plan, 3, FlawSpec(id=f"backlash_{axis}", size=size)))
    approach = found.approaches.set_index("axis").loc[axis]
    assert abs(approach.displacement + 2 * size) < 4 * approach.displacement_u
    assert approach.p_value < 1e-6
    assert found.ranked[0][0] == f"dir_{axis} along {axis}" or plan == "iso230_2"


def test_a_drift_shows_over_time_with_its_rate() -> None:
    session = simulated("tracking_3d")
    rate = 2e-10
    found = compare(moved(session, rate * session.readings.column("time")))
    added, clean = (one.trends.set_index("covariate")["added"]["time"] for one in (found, compare(session)))
    assert added - clean == pytest.approx(rate, rel=1e-3)


def test_added_drift_is_exactly_what_adding_it_gives() -> None:
    session = simulated("tracking_2d", 3, FlawSpec(id="linear_drift", amplitude=3e-6))
    added = compare(session).trends.set_index("covariate")["added"]["time"]
    rate = next(p for p in identify(session, effects=["linear_drift"]).parameters if p.name.startswith("linear_drift"))
    assert added == pytest.approx(rate.value, rel=1e-3)


def test_single_bad_readings_are_named_by_row_and_said_to_stand_out() -> None:
    simulation = simulate(SimulationSpec(plan=PRESETS["probing_cross"], seed=5, chips=Chips(fraction=0.02)))
    found = compare(simulation.session)
    rows = {*found.worst["row"][:3]}
    assert rows <= {int(row) for row in simulation.truth.document()["outliers"]}
    found_rows = {entry.row for entry in identify(simulation.session).rejected}
    assert set(found.outliers) == found_rows >= rows
    assert f"{len(found_rows)} readings do not belong to the rest" in in_words(found)


def test_rows_are_those_of_the_recording_where_readings_are_missing() -> None:
    session = simulated("tracking_2d", missing=0.1)
    readings = session.readings
    bad = int(np.flatnonzero(np.isfinite(readings.displacement))[150])
    change = np.zeros(len(readings))
    change[bad] = 1e-4
    found = compare(moved(session, change))
    assert found.worst["row"].iloc[0] == readings.row[bad]
    assert found.residuals["row"].tolist() == np.flatnonzero(np.isfinite(readings.displacement)).tolist()


def test_a_session_its_fit_and_its_result_give_the_same() -> None:
    session = simulated("tracking_2d", 3, FlawSpec(id="backlash_y", amplitude=1e-6))
    result = identify(session, effects=["backlash_y"])
    chosen = FitRequest((session,), effects=("backlash_y",))
    found: list[Comparison] = [compare(chosen), compare(result), compare(result.fit)]
    for other in found[1:]:
        np.testing.assert_allclose(other.fit.residuals, found[0].fit.residuals, atol=1e-13)
        assert other.overall.p_value == pytest.approx(found[0].overall.p_value, rel=1e-6)
    assert found[1].effects == ("backlash_y",)


def test_one_of_several_sessions_that_share_nothing_is_compared_as_if_alone() -> None:
    models = [build_model(simulated("tracking_2d", seed))[0] for seed in (1, 2)]
    joint = fit_models(models, ["a", "b"])
    for model, fit in zip(models, joint.fits, strict=True):
        one, alone = compare(fit), compare(fit_models([model]).fits[0])
        assert np.allclose(one.fit.residuals, alone.fit.residuals, atol=1e-13)
        mine, own = (each.residuals["studentized"] for each in (one, alone))
        assert np.allclose(mine, own, rtol=1e-4, atol=1e-4, equal_nan=True)
        assert one.overall.reduced_chi_square == pytest.approx(alone.overall.reduced_chi_square, rel=1e-4)
        assert one.overall.degrees_of_freedom == alone.overall.degrees_of_freedom
        assert one.overall.p_value == pytest.approx(alone.overall.p_value, abs=1e-4)
        noise = one.noise
        assert noise.from_repeats is not None and noise.repeats >= 8
        squares = noise.repeats * (noise.from_repeats / noise.declared) ** 2
        assert 1e-3 < stats.chi2.cdf(squares, noise.repeats) < 1 - 1e-3
        for mine, own in zip(one.setups.itertuples(), alone.setups.itertuples(), strict=True):
            assert (mine.name, mine.readings, mine.worst_row) == (own.name, own.readings, own.worst_row)
            assert mine.share == pytest.approx(own.share, rel=1e-4)
            assert mine.reduced_chi_square == pytest.approx(own.reduced_chi_square, rel=1e-4)
            assert mine.slope == pytest.approx(own.slope, rel=1e-3, abs=1e-14)


def test_covariates_that_do_not_vary_are_left_out_and_an_unknown_one_is_named() -> None:
    session = simulated("iso230_2")
    found = compare(session)
    assert "y" not in found.covariates
    assert "x" in covariates(found.fit.model.observations)
    with pytest.raises(ModelError, match="no covariate 'albedo' that varies; there are order"):
        found.covariate("albedo")


def test_bins_keep_distinct_values_apart_and_equal_ones_together() -> None:
    values = np.array([0.1 + 0.2, 0.3, 1.0, 1.0, 2.0])
    assert len(set(bins(values)[:2])) == 1
    assert bins(values)[4] not in bins(values)[:4]
    assert len(np.unique(bins(np.random.default_rng(0).normal(size=1000), 10))) == 10


@pytest.mark.parametrize("plan", PLANS)
def test_the_document_and_the_columns_hold_every_reading(plan: str) -> None:
    from machine_tool_calibration.reports.documents import to_json

    found = compared(plan)
    document = comparison_document(found)
    assert "NaN" not in to_json(document)
    assert document["format"] == "mtcal-comparison/1"
    columns = found.residuals
    assert len(columns) == found.overall.readings
    np.testing.assert_allclose(columns["measured"] - columns["predicted"], columns["residual"], atol=1e-15)


def test_readings_of_two_directions_at_one_place_are_no_repeats() -> None:
    """A deviation in x and one in y of the same hole are two arrows of the map, not their mean."""
    from machine_tool_calibration.plots.residuals import repeat_groups

    observations = build_model(simulated("grid_plate"))[0].observations
    same = repeat_groups(observations)
    for k in np.unique(same):
        np.testing.assert_allclose(np.ptp(observations.direction[same == k], axis=0), 0.0, atol=1e-9)


def test_readings_that_stand_out_are_counted_over_several_sessions() -> None:
    spec = SimulationSpec(plan=PRESETS["probing_cross"], seed=5, chips=Chips(fraction=0.02))
    sessions = [simulate(spec).session, simulate(SimulationSpec(plan=PRESETS["probing_cross"], seed=5)).session]
    found = compare(FitRequest(sessions, ("first", "second")))
    count = sum(len(one.outliers) for one in found.sessions)
    assert count > 1
    assert f" {count} readings do not belong to the rest" in in_words(found)


@pytest.mark.parametrize(("reduced", "scatter"), [(0.25, 1.0), (4.0, 2.0)])
def test_readings_that_scatter_less_than_declared_make_nothing_surer(reduced: float, scatter: float) -> None:
    nothing: Any = None
    solution: Any = SimpleNamespace(chi_square=8.0 * reduced, degrees_of_freedom=8)
    assert JointFit(nothing, solution).birge_ratio == scatter


def test_a_line_over_few_readings_is_judged_beside_itself() -> None:
    """The p-value of a line is that of a regression: the line is not in the scatter that it is held against."""
    read, side = np.array([88.0, 49.0, 101.7, 109.6, 56.5, 89.6]) * 1e-9, np.array([2.0, 1.0, 2.0, 2.0, 1.0, 2.0])
    found = compare(plates.session({"x": np.full(6, 0.1), "displacement": read, "side": side}, 1e-9))
    line, known = found.trends.set_index("covariate").loc["side"], stats.linregress(side, read)
    assert line.p_value == pytest.approx(known.pvalue, rel=1e-6)
    assert (line.added, line.added_u) == pytest.approx((known.slope, known.stderr), rel=1e-6)


def test_a_line_that_the_model_holds_has_no_size_in_it_where_setups_count_unequally() -> None:
    """What setups of different scatter leave over the place is known; what the model's own table would need is not."""
    rng, x = np.random.default_rng(1), np.tile(0.001 * np.arange(9), 6)
    setup = np.repeat([0, 1], 27)
    columns = {"x": x, "displacement": np.array([7e-6, 1e-6])[setup] * rng.normal(size=54)}
    repeat = np.tile(np.repeat(np.arange(3), 9), 2)
    found = compare(plates.session(columns, 1e-7, "offset", ["EXX"], repeat, "A", "B", setup=setup.tolist()))
    assert len(np.unique(found.fit.model.sigma)) == 2
    line = found.trends.set_index("covariate").loc["x"]
    assert np.isfinite(line[["slope", "slope_u"]].astype(float)).all() and np.isnan([line.added, line.added_u]).all()
    table = next(t for t in comparison_tables(found) if t.title == say("compared.trends"))
    assert table.note.endswith(str(say("compared.nowhere", names=say("head.needed_um"))))
