# SPDX-License-Identifier: Apache-2.0
"""The figures of ISO 230-2:2014 and ISO 230-6:2002, against numbers worked out by hand.
Position errors against the truth: their size is as stated.
"""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array, rms
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.methods.iso230_2 import FIGURES, Positioning, _runs, positioning, positioning_uncertainty
from machine_tool_calibration.reports.goodness import scatter_words
from machine_tool_calibration.reports.identification import goodness_of_fit
from machine_tool_calibration.session.session import Readings, Session

from ... import plates
from ...told import keys

# Two positions, three runs up and three down, um.
POSITION = np.repeat([0.0, 0.1], 6)
DIRECTION = np.tile([1, 1, 1, -1, -1, -1], 2)
DEVIATION = 1e-6 * np.array([1.0, 2.0, 3.0, 5.0, 5.0, 5.0, -1.0, 0.0, 1.0, 2.0, 4.0, 6.0])


def test_by_hand() -> None:
    f = positioning(POSITION, DIRECTION, DEVIATION)
    um = 1e-6
    np.testing.assert_allclose(f.mean_up, [2 * um, 0.0], atol=1e-18)
    np.testing.assert_allclose(f.mean_down, [5 * um, 4 * um])
    np.testing.assert_allclose(f.s_up, [1 * um, 1 * um])
    np.testing.assert_allclose(f.s_down, [0.0, 2 * um], atol=1e-18)
    np.testing.assert_allclose(f.reversal, [-3 * um, -4 * um])
    assert pytest.approx(4 * um) == f.B
    assert pytest.approx(-3.5 * um) == f.B_mean
    assert pytest.approx(4 * um) == f.R_up
    assert pytest.approx(8 * um) == f.R_down
    # 2 s_up + 2 s_down + |B|: 2 + 0 + 3 and 2 + 4 + 4
    np.testing.assert_allclose(f.repeatability, [5 * um, 10 * um])
    assert pytest.approx(10 * um) == f.R
    assert pytest.approx(2 * um) == f.E_up
    assert pytest.approx(1 * um) == f.E_down
    assert pytest.approx(5 * um) == f.E  # 5 - 0
    assert pytest.approx(1.5 * um) == f.M  # 3.5 - 2
    assert pytest.approx((4 - -2) * um) == f.A_up  # 2 + 2 - (0 - 2)
    assert pytest.approx((8 - 0) * um) == f.A_down  # 4 + 4 - (4 - 4)
    assert pytest.approx((8 - -2) * um) == f.A


def test_ends_at_which_the_runs_turned_do_not_count() -> None:
    """Approached from one side only, where the runs did not go beyond: all other positions give the figures."""
    inner = positioning(POSITION, DIRECTION, DEVIATION)
    ends, way = np.repeat([-0.1, 0.2], 3), np.repeat([-1, 1], 3)
    there = 1e-6 * np.array([20.0, 21.0, 25.0, 30.0, 31.0, 35.0])
    turned = positioning(np.r_[ends, POSITION], np.r_[way, DIRECTION], np.r_[there, DEVIATION])
    assert len(turned.position) == 4 and np.isnan(turned.reversal[[0, -1]]).all()
    assert [getattr(turned, name) for name in FIGURES] == [getattr(inner, name) for name in FIGURES]
    every = (np.r_[ends, POSITION], np.r_[way, DIRECTION], np.r_[there, DEVIATION])
    assert positioning_uncertainty(turned, *runs_of(turned, *every)) == pytest.approx(
        positioning_uncertainty(inner, *runs_of(inner, POSITION, DIRECTION, DEVIATION))
    )
    # Where one in the middle lacks a direction, that is missing.
    middle = positioning(np.r_[POSITION, 0.05], np.r_[DIRECTION, 1], np.r_[DEVIATION, 0.0])
    assert np.isnan(middle.B) and np.isfinite(middle.E_up)


def runs_of(figures: Positioning, position: Array, direction: Array, deviation: Array) -> tuple[Array, Array]:
    up, down = (_runs(figures.position, position, deviation, direction * sign > 0) for sign in (1, -1))
    return up, down


@pytest.mark.parametrize("of_run", [0.0, 0.3e-6])
def test_u_counts_that_the_largest_is_too_large_and_what_a_run_shares(of_run: float) -> None:
    """Eleven positions, five runs each way, a reversal of 2 um: figures of the machine lie within U of those found."""
    rng, noise, runs = np.random.default_rng(7), 0.3e-6, 5
    place = np.tile(np.linspace(0.0, 0.5, 11), 2 * runs)
    way = np.repeat(np.tile([1, -1], runs), 11)
    s = np.hypot(noise, of_run)
    true = {"B": 2e-6, "B_mean": 2e-6, "R_up": 4.0 * s, "R_down": 4.0 * s}
    within = dict.fromkeys(true, 0.0)
    for _ in range(100):
        read = 1e-6 * way + noise * rng.normal(size=len(way)) + of_run * np.repeat(rng.normal(size=2 * runs), 11)
        found = positioning(place, way, read)
        u = positioning_uncertainty(found, *runs_of(found, place, way, read))
        for name, value in true.items():
            within[name] += 0.01 * (abs(getattr(found, name) - value) <= u[name])
    assert within.pop("B") > 0.7  # the largest of eleven that are all the same
    assert min(within.values()) > 0.85


def test_single_runs_give_means_but_no_repeatability() -> None:
    f = positioning(np.array([0.0, 0.1, 0.1, 0.0]), np.array([1, 1, -1, -1]), 1e-6 * np.array([0.0, 1.0, 2.0, 3.0]))
    assert pytest.approx(3e-6) == f.B and pytest.approx(3e-6) == f.E
    assert np.isnan([f.R, f.A, f.R_up]).all()


def test_one_direction_gives_no_reversal() -> None:
    f = positioning(np.array([0.0, 0.0, 0.1, 0.1]), np.ones(4), 1e-6 * np.array([0.0, 1.0, 2.0, 3.0]))
    assert np.isnan([f.B, f.R, f.E, f.M, f.A]).all()
    assert pytest.approx(2e-6) == f.E_up
    assert pytest.approx(4 * np.sqrt(0.5) * 1e-6) == f.R_up


def test_a_run_of_a_session_is_reported(direct: SimpleNamespace) -> None:
    simulated = direct.measured("iso230_2", repeats=5, effects=[{"id": "backlash_x", "size": 3e-6}])
    (run,) = identify(simulated.session).document()["error_map"]["iso230_2"]
    assert (run["setup"], run["axis"]) == ("X", "X")
    readings = simulated.session.readings
    own = positioning(np.round(readings.columns["x"], 9), readings.columns["dir_x"].astype(int), readings.displacement)
    assert run["B"] == pytest.approx(own.B) and run["A"] == pytest.approx(own.A)
    assert abs(run["B_mean"]) == pytest.approx(6e-6, abs=1e-7)  # twice the half width


def bare(session: Session) -> Readings:
    """Readings of which the sense of the last move was not recorded."""
    columns = {name: values for name, values in session.readings.columns.items() if name != "dir_x"}
    return replace(session.readings, columns=columns)


def test_direction_of_approach_follows_from_the_order_where_it_is_not_recorded(direct: SimpleNamespace) -> None:
    simulated = direct.measured("iso230_2", repeats=3, effects=[{"id": "backlash_x", "size": 3e-6}])
    (with_column,) = identify(simulated.session).error_map.content["iso230_2"]
    (without,) = identify(simulated.session.with_readings(bare(simulated.session))).error_map.content["iso230_2"]
    np.testing.assert_allclose(without["reversal"], with_column["reversal"], atol=1e-12)


def test_runs_that_begin_anew_at_one_end_went_one_way(direct: SimpleNamespace) -> None:
    """A turning table or an axis that goes back unread: nothing was approached from above."""
    session = direct.measured("iso230_2", repeats=5).session
    up = bare(session).select(session.readings.columns["dir_x"] > 0)
    (run,) = identify(session.with_readings(up)).error_map.content["iso230_2"]
    assert run["count_up"].tolist() == [5] * len(run["position"]) and not run["count_down"].any()
    assert run["E_up"] > 0.0 and np.isnan(run["B"])
    # Nothing moves between the readings of one place, at the end of a run neither.
    thrice = session.with_readings(up.select(np.repeat(np.arange(len(up)), 3)))
    (run,) = identify(thrice).error_map.content["iso230_2"]
    assert run["count_up"].tolist() == [15] * len(run["position"]) and not run["count_down"].any()
    # Nor where repeats count the readings of a place.
    once = up.select(up.repeat == 0)
    one = once.select(np.repeat(np.arange(len(once)), 10))
    counted = session.with_readings(replace(one, repeat=np.tile(np.arange(10), len(once))))
    (run,) = identify(counted).error_map.content["iso230_2"]
    assert run["count_up"].tolist() == [10] * len(run["position"]) and not run["count_down"].any()


@pytest.mark.parametrize("kind", ["straightness", "grid_plate", "drilled_plate"])
def test_other_measurements_are_no_such_run(direct: SimpleNamespace, kind: str) -> None:
    assert "iso230_2" not in identify(direct.measured(kind, repeats=2).session).error_map.content


@pytest.mark.long
def test_uncertainty_of_the_figures_is_that_of_repeated_tests() -> None:
    kept: dict[str, list[float]] = {}
    stated: dict[str, list[float]] = {}
    for seed in range(40):
        session = plates.axis(seed, noise=5e-7, backlash=2e-6, scale=2e-5)
        (run,) = identify(session).document()["error_map"]["iso230_2"]
        for name in ("B", "B_mean", "E", "M", "A"):
            kept.setdefault(name, []).append(run[name])
            stated.setdefault(name, []).append(run[f"{name}_U"])
    (exact,) = identify(plates.axis(0, noise=1e-12, backlash=2e-6, scale=2e-5)).document()["error_map"]["iso230_2"]
    exact["A"] += 4.0 * 5e-7  # two standard deviations on either side
    for name, values in kept.items():
        assert np.mean(stated[name]) == pytest.approx(2.0 * rms(np.array(values) - exact[name]), rel=0.35), name
    # A mean over 11 positions and 5 runs each way: 2 sqrt(2 / 55) 0.5 um
    assert np.mean(stated["B_mean"]) == pytest.approx(2.0 * np.sqrt(2.0 / 55.0) * 5e-7, rel=0.1)


def test_single_runs_have_no_uncertainty() -> None:
    (run,) = identify(plates.axis(1, runs=1)).document()["error_map"]["iso230_2"]
    assert "B_U" not in run and run["B"] is not None


def test_every_figure_has_an_uncertainty_and_the_single_runs_are_kept() -> None:
    session = plates.axis(1)
    (run,) = identify(session).document()["error_map"]["iso230_2"]
    assert all(run[f"{name}_U"] > 0.0 for name in FIGURES)
    up = np.array(run["runs_up"], float)
    assert up.shape == (5, 11)
    np.testing.assert_allclose(up.mean(axis=0), run["mean_up"], atol=1e-15)
    np.testing.assert_allclose(up.std(axis=0, ddof=1), run["s_up"], atol=1e-15)


def test_a_reversal_is_no_fault_of_the_model(direct: SimpleNamespace) -> None:
    session = direct.measured("iso230_2", repeats=5, effects=[{"id": "backlash_x", "size": 3e-6}]).session
    document = identify(session).document()
    assert document["p_value"] < 1e-6
    assert "which is part of the result (ISO 230-2)" in goodness_of_fit(document)
    # A drift is no reversal.
    drifting = direct.measured("iso230_2", repeats=5, effects=[{"id": "linear_drift", "size": 2e-8}]).session
    assert "part of the result" not in goodness_of_fit(identify(drifting).document())


# Two runs there and back along two face diagonals, um: the first as along an axis, the second with half of it.
FORTH = np.array([[0.0, 1.0, 4.0], [0.0, 3.0, 4.0]])
BACK = np.array([[-1.0, 1.0, 2.0], [-3.0, 1.0, 4.0]])


def test_diagonals_by_hand(direct: SimpleNamespace) -> None:
    line, back = np.array([0.0, 0.1, 0.2]), [2, 1, 0]
    place = np.tile(np.r_[line, line[back]], 4)
    sense = np.repeat([1.0, -1.0], 12)
    at = np.column_stack([np.where(sense > 0, place, 0.2 - place), place, np.zeros(24)])
    g = np.column_stack([sense, np.ones(24), np.zeros(24)])
    one = 1e-6 * np.concatenate([part for k in range(2) for part in (FORTH[k], BACK[k][back])])
    session = direct.written(
        at, g, np.r_[one, 0.5 * one], setup=np.repeat([0, 1], 12), setups=("A", "B"), terms=("EXX", "EYY"),
        columns={"dir_x": sense * np.tile(np.repeat([1, -1], 3), 4), "dir_y": np.tile(np.repeat([1, -1], 3), 4)},
    )  # fmt: skip
    found = identify(session, keep_all=True).error_map.content
    assert "iso230_2" not in found
    first, second = found["iso230_6"]["runs"]
    assert (first["axis"], second["axis"]) == ("PP0", "NP0")
    for run in (first, second):  # from the end that is reached first, wherever that is
        np.testing.assert_allclose(run["position"], np.sqrt(2.0) * line, atol=1e-15)
    # Means: up 0, 2, 4, down -2, 1, 3
    (test,) = found["iso230_6"]["tests"]
    assert (test["diagonals"], test["measured"], test["of"]) == ("XY", 2, 2)
    expected = {"E_D": 6e-6, "E_D_up": 4e-6, "E_D_down": 5e-6, "B_D": 2e-6}
    assert {name: test[name] for name in expected} == pytest.approx(expected)
    assert second["E"] == pytest.approx(3e-6)


def _judged(direct: SimpleNamespace, kind: str, runs: int, **plan: Any) -> tuple[float, float, float]:
    """Mean squared normalised error, RMS error over the stated one, and mean reduced chi-square."""
    normalised, errors, stated, chi = [], [], [], []
    for seed in range(runs):
        simulated = direct.measured(kind, seed, **plan)
        result = identify(simulated.session)
        content = result.error_map.content
        points = content["points"]
        sensed = np.abs(result.fit.model.observations.direction).max(axis=0) > 0.5
        error = (content["position_error"] - simulated.truth.machine.position_error(points))[:, sensed]
        uncertainty = content["position_error_u"][:, sensed]
        if simulated.session.description.datum == "rigid":
            error = direct.fitted_out(error, direct.rigid_motions(points)[:, sensed])
        elif simulated.session.description.datum == "offset":
            error = error - error.mean()
        there = uncertainty > 1e-12
        normalised.append(np.mean((error[there] / uncertainty[there]) ** 2))
        errors.append(np.mean(error**2))
        stated.append(np.mean(uncertainty**2))
        chi.append(result.fit.joint.reduced_chi_square)
    return float(np.mean(normalised)), float(np.sqrt(np.mean(errors) / np.mean(stated))), float(np.mean(chi))


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "plan"),
    [("iso230_2", {"repeats": 3}), ("iso230_2", {"repeats": 3, "datum": "offset"}), ("straightness", {"repeats": 3})],
)
def test_lines_over_many_runs(direct: SimpleNamespace, kind: str, plan: dict[str, Any], many: Any) -> None:
    normalised, ratio, chi = _judged(direct, kind, many.count, **plan)
    assert normalised == pytest.approx(1.0, abs=many.off(0.1))
    assert ratio < 1.0 + many.off(0.1)
    assert chi == pytest.approx(1.0, abs=many.off(0.05))


def test_grid_over_some_runs(direct: SimpleNamespace, many: Any) -> None:
    some = many.part(0.6)
    normalised, ratio, chi = _judged(direct, "grid_plate", some.count, misplacement=1e-5)
    assert normalised == pytest.approx(1.0, abs=some.off(0.05))
    assert ratio < 1.0 + some.off(0.05)
    assert chi == pytest.approx(1.0, abs=some.off(0.025))


def test_part_that_lies_milliradians_askew(direct: SimpleNamespace) -> None:
    # The second order of the turn, 3 um over the plate, would pass for a scale.
    side = np.linspace(0.0, 0.4, 6)
    place = np.array([(x, y, 0.0) for y in side for x in side])
    actual = place * (1.0 + 1e-5)
    turn = 4e-3
    c, s = np.cos(turn), np.sin(turn)
    seen = actual @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T + [3e-4, -2e-4, 0.0]
    reading = np.concatenate([(seen - place)[:, 0], (seen - place)[:, 1]])
    g = np.concatenate([np.tile(np.eye(3)[0], (36, 1)), np.tile(np.eye(3)[1], (36, 1))])
    session = direct.written(np.tile(place, (2, 1)), g, reading, datum="rigid")
    (scale,) = (p for p in identify(session, effects=["scale"]).parameters if p.name == "scale.s")
    assert scale.value == pytest.approx(1e-5, abs=5e-8)


@pytest.mark.parametrize(("u", "said"), [(2.5e-6, "fit.reversal"), (0.5e-6, "fit.reversal_beside")])
def test_a_map_is_said_to_contain_the_reversal_only_where_it_does(u: float, said: str) -> None:
    """Each direction is 4 um from the map's value for both."""
    scatter = {"found": 4e-6, "declared": 2e-7, "one_direction": 2e-7, "one_direction_p_value": 0.5}
    content = {"scatter": scatter | {"uncertainties_from": "scatter"}, "position_error_u": [[u, None, None]] * 11}
    words = scatter_words(content, 0.0)
    assert words is not None and keys(words)[-1] == said
