# SPDX-License-Identifier: Apache-2.0
"""Places that are off the tables of X and Y, read again in runs and setups that differ by offsets."""

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.methods.identify import identify_sessions
from machine_tool_calibration.model.fit import declared
from machine_tool_calibration.session.session import Session

from ... import plates

TIMES, NOISE, OFFSETS, OFF = 6, 3e-6, 58e-6, 29e-6


def measured(seed: int, *, setups: bool = False, off: float = OFF) -> tuple[Session, float, float]:
    """A plate of 3 by 3 places, read `TIMES` times; EZX and EZY at the last node, m."""
    rng = np.random.default_rng(seed)
    x, y = np.repeat([0.0, 0.1, 0.2], 3), np.tile([0.0, 0.1, 0.2], 3)
    ezx, ezy = np.append(0.0, rng.normal(0.0, 5e-5, 2)), rng.normal(0.0, 5e-5, 3)
    places = np.add.outer(ezx, ezy).ravel() + rng.normal(0.0, off, 9)
    again = np.repeat(np.arange(TIMES), 9)
    read = np.tile(places, TIMES) + rng.normal(0.0, OFFSETS, TIMES)[again] + rng.normal(0.0, NOISE, 9 * TIMES)
    columns = {"x": np.tile(x, TIMES), "y": np.tile(y, TIMES), "gz": 1.0, "displacement": read}
    each = {"setup": again.tolist()} if setups else {}
    names = [f"S{k}" for k in range(TIMES)] if setups else ["A"]
    repeat = None if setups else again
    datum = "offset" if setups else "none"
    session = plates.session(columns, NOISE, datum, ["EZX", "EZY"], repeat, *names, **each, repeats=len(set(again)))
    return session, float(ezx[-1]), float(ezy[-1])


def found(session: Session, name: str) -> tuple[float, float]:
    """A node's value and standard uncertainty, m."""
    parameters = identify_sessions(FitRequest.of(session)).document()["parameters"]
    (one,) = (p for p in parameters if p["name"] == name)
    return one["value"], one["standard_uncertainty"]


@pytest.mark.parametrize("setups", [False, True])
def test_u_of_a_node_is_that_of_few_places(setups: bool) -> None:
    """The difference of two nodes is of three places each, however often they were read: 29 um sqrt(2 / 3).

    In setups with offsets of their own it had been a third of that.
    """
    errors, uncertainties = [], []
    for seed in range(12):
        session, ezx, _ = measured(seed, setups=setups)
        value, u = found(session, "EZX(0.2)")
        errors.append(value - ezx)
        uncertainties.append(u)
    expected = OFF * np.sqrt(2.0 / 3.0)
    assert np.sqrt(np.mean(np.square(uncertainties))) == pytest.approx(expected, rel=0.25)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(expected, rel=0.4)


def test_what_runs_differ_by_does_not_grow_with_what_places_are_off_by() -> None:
    """A level is of three places and six runs: sqrt(29^2 / 3 + 58^2 / 6) um; it had been 175 um."""
    uncertainties = [found(measured(seed)[0], "EZY(0.2)")[1] for seed in range(12)]
    expected = np.sqrt(OFF**2 / 3.0 + OFFSETS**2 / TIMES)
    assert np.sqrt(np.mean(np.square(uncertainties))) == pytest.approx(expected, rel=0.3)


def test_places_that_are_on_the_tables_change_no_u() -> None:
    plain = [found(measured(seed, setups=True, off=0.0)[0], "EZX(0.2)")[1] for seed in range(6)]
    assert np.mean(plain) == pytest.approx(NOISE * np.sqrt(2.0 / 18.0), rel=0.25)


def test_places_that_differ_are_said_beside_runs_that_differ_more() -> None:
    """It had been said that no pattern stands out, beside a p-value of 1e-28 of the lack of fit."""
    left = diagnose(measured(1)[0]).left
    assert [(one.covariate, one.shape.key) for one in left] == [("place", "shape.places_differ")]
    assert not diagnose(measured(1, off=0.0)[0]).left


def test_readings_of_one_place_tell_the_noise() -> None:
    """A model of the place leaves nothing of it: what is left is noise, also where a part of it is far out."""
    rng = np.random.default_rng(0)
    read = rng.standard_t(2.0, 50) * 5e-3
    columns = {"x": np.full(50, 0.05)}
    time = {"time": 8.0 * np.arange(50)}
    session = plates.session(columns | time | {"displacement": read}, 7e-5, "none", ["EXX"], np.arange(50), repeats=50)
    one = diagnose(session)
    kept = one.chosen.sessions[0].readings.displacement
    assert one.noise.from_repeats == pytest.approx(np.std(kept[np.isfinite(kept)], ddof=1))
    assert one.noise.lack_of_fit_p is None and one.noisy and one.verdict in ("adequate", "outliers")


@pytest.mark.parametrize("timed", [False, True])
def test_a_raster_says_nothing_of_runs(timed: bool) -> None:
    """Four zones, one after the other, by a machine that yaws: what goes on with the order of rows is the machine's.

    As slopes of runs it had moved the map of a stage by eight times the error of plain least squares.
    """
    grid = np.stack(np.meshgrid(*[np.linspace(-0.12, 0.12, 9)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    at = np.concatenate([grid + np.array([dx, dy]) for dx in (-0.06, 0.06) for dy in (-0.06, 0.06)])
    yaw = 5e-6 * np.sin(8.0 * at[:, 0])
    off = np.column_stack([-yaw * at[:, 1], np.zeros(len(at))])
    off += 1e-7 * np.random.default_rng(0).normal(size=off.shape)
    x, y = np.repeat(at, 2, axis=0).T
    gx = np.tile([1.0, 0.0], len(at))
    columns = {"x": x, "y": y, "gx": gx, "gy": 1.0 - gx, "displacement": off.ravel()}
    columns |= {"time": 10.0 * np.arange(len(gx))} if timed else {}
    setup = np.repeat(np.arange(4), 2 * len(grid)).tolist()
    terms = ["EXX", "EYY", "EXY", "EYX", "C0Y"]
    session = plates.session(columns, 1e-7, "rigid", terms, None, *"ABCD", setup=setup)
    fitted = fit_sessions(FitRequest.of(session))
    published, plain = fitted.error_map.error, fitted.map_of(declared(fitted.joint)).error
    np.testing.assert_allclose(published, plain, atol=1e-8)


@pytest.mark.parametrize("axes", ["x", "xy"])
@pytest.mark.parametrize("step", [5e-6, 1e-5])
def test_a_step_between_two_runs_is_no_drift(axes: str, step: float) -> None:
    """A zero that is taken anew, or a part that is touched: within the runs nothing drifts.

    As a drift, with a probability of up to 0.99, it was in the map with 3 to 13 times the error of the first one.
    """
    at = np.linspace(0.0, 0.4, 9 if axes == "x" else 5)
    x, y = (at, 0.0 * at) if axes == "x" else (grid.ravel() for grid in np.meshgrid(at, at))
    for seed in range(4):
        rng, n = np.random.default_rng(seed), len(x)
        run = np.repeat([0, 1], n)
        read = step * run + rng.normal(0.0, 1e-6, 2 * n)
        columns = {"x": np.tile(x, 2), "y": np.tile(y, 2), "gx": np.ones(2 * n), "gy": np.zeros(2 * n)}
        columns |= {"gz": np.zeros(2 * n), "time": 10.0 * np.arange(2 * n), "displacement": read}
        terms = ["EXX"] if axes == "x" else ["EXX", "EXY"]
        found = diagnose(plates.session(columns, 1e-6, "offset", terms, run, repeats=2))
        assert not found.accepted and found.search.of("linear_drift").probability < 0.5


def test_setups_that_stand_aslant_are_in_u() -> None:
    """Three setups that overlap, each read three times: that they repeat says nothing of how aslant each stands.

    U had held at two places of three, the sizes of what differs being those within a setup.
    """
    within = []
    for seed in range(12):
        rng, rows = np.random.default_rng(seed), []
        for setup, first in enumerate((0.0, 0.1, 0.2)):
            at, aslant = first + np.linspace(0.0, 0.3, 7), 12e-6 * rng.normal()
            rows += [(setup, k, x, aslant * x + 1e-6 * rng.normal()) for k in range(3) for x in at]
        setup, again, x, read = np.array(rows).T
        columns = {"x": x, "displacement": read}
        each = {"setup": setup.astype(int).tolist(), "repeats": 3}
        found = fit_sessions(FitRequest.of(plates.session(columns, 1e-6, "offset", ["EXX"], again, *"ABC", **each)))
        off = found.error_map.error[:, 0] - found.error_map.error[:, 0].mean()
        within.append(np.mean(np.abs(off) < 2.0 * found.error_map.uncertainty[:, 0]))
    assert np.mean(within) > 0.75


@pytest.mark.parametrize("timed", [False, True])
def test_runs_at_one_place_that_differ_are_in_u_and_no_drift(timed: bool) -> None:
    """Nine runs of ten readings: the mean is as uncertain as the means of runs say, U had been half of that."""
    ratio, effects = [], []
    for seed in range(8):
        rng, run = np.random.default_rng(seed), np.repeat(np.arange(9), 10)
        read = 50e-6 * rng.normal(size=9)[run] + 50e-6 * rng.normal(size=90)
        columns = {"x": 0.0, "y": 0.0, "z": 0.0, "displacement": read} | (
            {"time": 60.0 * np.arange(90)} if timed else {}
        )
        session = plates.session(columns, 50e-6, "offset", [], run, repeats=9)
        mean = fit_sessions(FitRequest.of(session)).joint.published
        ratio.append(np.sqrt(mean.covariance[0, 0]) / (np.std(read.reshape(9, 10).mean(axis=1), ddof=1) / 3.0))
        effects.append(len(diagnose(session).accepted))
    assert np.median(ratio) == pytest.approx(1.0, abs=0.25)
    assert not any(effects)


def test_how_much_setups_differ_where_places_differ_from_setup_to_setup() -> None:
    """Six setups of eight places, three times each: 10 um, 5 um and 1 um; it had been told as 2.2 um (1.2 to 5)."""
    within = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        offset, setup, place = 10e-6 * rng.normal(size=6), np.repeat(np.arange(6), 24), np.tile(np.arange(8), 18)
        read = offset[setup] + 5e-6 * rng.normal(size=(6, 8))[setup, place] + 1e-6 * rng.normal(size=144)
        columns = {"x": 0.1 * place, "displacement": read}
        each = {"setup": setup.tolist(), "repeats": 3}
        again = np.tile(np.repeat(np.arange(3), 8), 6)
        session = plates.session(columns, 1e-6, "none", ["EXX"], again, *"ABCDEF", **each)
        (size,) = (one for one in fit_sessions(FitRequest.of(session)).joint.marginal.sizes if one.name == "setup")
        within.append(size.low < np.std(offset, ddof=1) < size.high)
    assert np.mean(within) > 0.8
