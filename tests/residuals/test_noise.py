# SPDX-License-Identifier: Apache-2.0
"""Noise from repeats: of readings that repeat each other, and of no others."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.model.fit import Fit, fit_models
from machine_tool_calibration.residuals.averaged import mean_places
from machine_tool_calibration.residuals.noise import noise_of
from machine_tool_calibration.residuals.places import alike_beside_p
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate


def fitted(plan: str, off: float, *, zone: bool = False) -> Fit:
    """A session in which every place is off by an amount of its own, or all of a zone, in standard uncertainties."""
    chosen = PRESETS[plan]
    if chosen.method == "tracking_interferometer":
        # Every second run backwards would approach a place from the other side: no repeat.
        chosen = chosen.model_copy(update={"order": "same"})
    session = simulate(SimulationSpec(plan=chosen, seed=3)).session
    place = build_model(session)[0].observations.place
    change = off * session.sigma * np.random.default_rng(3).normal(size=place.max() + 1)
    readings = session.readings
    if zone:
        x, y = readings.columns["x"], readings.columns["y"]
        change, place = off * session.sigma * np.arange(2), ((x > 0.5 * x.max()) & (y > 0.5 * y.max())).astype(int)
    moved = session.with_readings(replace(readings, displacement=readings.displacement + change[place]))
    return fit_models([build_model(moved)[0]]).fits[0]


def test_readings_of_a_plate_that_was_drilled_once_are_averaged_hole_by_hole() -> None:
    """And by the side from which it was approached."""
    fit = fitted("grid_plate", 6.0)
    session = fit.model.observations.session
    averaged = mean_places(fit)
    assert averaged is not None and mean_places(fitted("iso230_2", 6.0)) is None

    def keys(one: Session) -> Array:
        return np.array([one.readings.columns[name] for name in ("x", "y", "gx", "gy", "dir_x", "dir_y")]).T

    holes, expected = keys(averaged[0]), []
    for hole in holes:
        mine = (keys(session) == hole).all(axis=1)
        expected.append(session.readings.displacement[mine].mean())
    assert len(np.unique(holes, axis=0)) == len(holes) == len(np.unique(keys(session), axis=0))
    np.testing.assert_allclose(averaged[0].readings.displacement, expected, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("plan", ["tracking_2d", "iso230_2", "grid_plate", "step_diagonal"])
def test_repeats_show_the_noise_however_much_places_differ(plan: str) -> None:
    for off in (0.0, 6.0):
        noise = noise_of(fitted(plan, off))
        assert noise.from_repeats is not None and noise.lack_of_fit_p is not None
        assert noise.from_repeats == pytest.approx(noise.declared, rel=4.0 / np.sqrt(2.0 * noise.repeats))
        if off:
            assert noise.lack_of_fit_p < 1e-6
        else:
            assert noise.lack_of_fit_p > 1e-3


def test_repeats_that_agree_to_the_last_digit_scatter_by_what_rounding_takes() -> None:
    session, digit = fitted("grid_plate", 6.0).model.observations.session, 1e-5
    place = build_model(session)[0].observations.place
    mean = np.bincount(place, session.readings.displacement) / np.bincount(place)
    rounded = replace(session.readings, displacement=digit * np.round(mean[place] / digit))
    fit = fit_models([build_model(session.with_readings(rounded))[0]]).fits[0]
    assert noise_of(fit).from_repeats == pytest.approx(digit / np.sqrt(12.0), rel=1e-6)


def test_places_beside_each_other_are_alike_where_a_zone_is_off_and_not_where_each_is_by_itself() -> None:
    alone, zone = (alike_beside_p(fitted("grid_plate", 6.0, zone=zone)) for zone in (False, True))
    assert alone is not None and alone > 1e-3
    assert zone is not None and zone < 1e-6


def test_repeats_as_they_were_read_hold_what_runs_differ_by() -> None:
    session = fitted("iso230_2", 0.0).model.observations.session
    run = 10.0 * session.sigma * session.readings.repeat
    moved = session.with_readings(replace(session.readings, displacement=session.readings.displacement + run))
    noise = noise_of(fit_models([build_model(moved)[0]]).fits[0])
    assert noise.from_repeats == pytest.approx(noise.declared, rel=0.3)
    assert noise.as_read is not None and noise.as_read > 5.0 * noise.declared
    # Pooled over the places, each run counted once: the standard deviations of the places by themselves.
    place, values = build_model(moved)[0].observations.place, moved.readings.displacement
    variances = [np.var(values[place == k], ddof=1) for k in range(place.max() + 1)]
    assert noise.as_read == pytest.approx(np.sqrt(np.mean(variances)), rel=1e-9)


def test_what_is_read_along_another_direction_is_no_neighbour() -> None:
    """A hole off by as much along x as along y, and each by itself: no zone is."""
    session = simulate(SimulationSpec(plan=PRESETS["grid_plate"], seed=3)).session
    readings = session.readings
    hole = np.unique(readings.position(), axis=0, return_inverse=True)[1].reshape(-1)
    change = 6.0 * session.sigma * np.random.default_rng(3).normal(size=hole.max() + 1)[hole]
    moved = session.with_readings(replace(readings, displacement=readings.displacement + change))
    p = alike_beside_p(fit_models([build_model(moved)[0]]).fits[0])
    assert p is not None and p > 1e-3
