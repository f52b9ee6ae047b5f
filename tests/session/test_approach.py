# SPDX-License-Identifier: Apache-2.0
"""Senses of approach that were not recorded, from the order of the rows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests import plates

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.planning.what_to_measure import what_to_measure
from machine_tool_calibration.session.approach import approaches, begins_run, senses
from machine_tool_calibration.session.checks.suspicion import suspicions
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

DATA = Path(__file__).parents[1] / "data"
PLACES = np.linspace(0.0, 0.4, 9)


def unrecorded(session: Session) -> Session:
    columns = {name: values for name, values in session.readings.columns.items() if not name.startswith("dir_")}
    return replace(session, readings=replace(session.readings, columns=columns))


def line(*runs: np.ndarray, repeat: bool = False, lost: float = 0.0) -> Session:
    """Runs along X; the places are displaced by `lost` against the sense in which a run goes."""
    rng, x = np.random.default_rng(5), np.concatenate(runs)
    sense = np.concatenate([np.full(len(run), np.sign(run[-1] - run[0])) for run in runs])
    numbers = np.repeat(np.arange(len(runs)), [len(run) for run in runs]) if repeat else np.zeros(len(x), dtype=int)
    read = 3e-6 * np.sin(9.0 * x) - lost * sense + 1e-6 * rng.normal(size=len(x))
    return plates.session({"x": x, "displacement": read}, 1e-6, "offset", ["EXX"], numbers)


@pytest.mark.parametrize("repeat", [False, True])
def test_the_second_reading_at_a_turning_point_comes_from_beyond(repeat: bool) -> None:
    session = line(PLACES, PLACES[::-1], PLACES, PLACES[::-1], repeat=repeat)
    np.testing.assert_array_equal(approaches(session)["dir_x"], np.repeat([1.0, -1.0, 1.0, -1.0], 9))


def test_each_run_that_goes_one_way_begins_as_it_goes_on() -> None:
    session = line(PLACES, PLACES, PLACES[::-1], repeat=True)
    np.testing.assert_array_equal(approaches(session)["dir_x"], np.repeat([1.0, 1.0, -1.0], 9))


def test_nothing_moves_between_readings_of_one_place() -> None:
    session = line(np.repeat(PLACES, 3), np.repeat(PLACES[::-1], 3))
    sense = approaches(session)["dir_x"]
    np.testing.assert_array_equal(sense[:27], 1.0)
    np.testing.assert_array_equal(sense[27:], -1.0)


@pytest.mark.parametrize("times", [2, 3])
def test_repeats_of_a_place_are_no_runs(times: int) -> None:
    """Numbered 0, 1, … at each place: read upwards only, no place is approached from above."""
    along, repeat = np.repeat(np.arange(6), times), np.tile(np.arange(times), 6)
    elsewhere = np.diff(along, prepend=-1) != 0
    begins = begins_run(along, repeat, elsewhere)
    assert np.flatnonzero(begins).tolist() == [0]
    np.testing.assert_array_equal(senses(along, elsewhere, begins), 1.0)


def test_what_was_set_aside_was_on_the_way() -> None:
    session = line(PLACES, PLACES[::-1])
    gone = np.isin(np.arange(18), [8, 12])
    np.testing.assert_array_equal(approaches(session.without(gone))["dir_x"], approaches(session)["dir_x"][~gone])


def test_a_pass_ends_where_a_place_is_read_twice_as_often() -> None:
    session = line(np.repeat(PLACES, 3), np.repeat(PLACES[::-1], 3))
    np.testing.assert_array_equal(approaches(session)["dir_x"], np.repeat([1.0, -1.0], 27))


def test_what_goes_back_all_the_way_begins_a_run() -> None:
    session = line(PLACES, PLACES, PLACES[::-1], PLACES[::-1])
    np.testing.assert_array_equal(approaches(session)["dir_x"], np.repeat([1.0, -1.0], 18))


def test_runs_along_several_axes_and_readings_without_a_position() -> None:
    """What stands in a setup has no sense there; a column that says nothing is as one that is not there."""
    runs, still = np.tile(np.concatenate([PLACES, PLACES[::-1]]), 2), np.zeros(36)
    columns = {"x": np.append(runs, still), "y": np.append(still, runs), "dir_x": np.zeros(72)}
    columns |= {"gx": np.repeat([1.0, 0.0], 36), "gy": np.repeat([0.0, 1.0], 36), "gz": np.zeros(72)}
    columns["x"][5] = np.nan
    setup = np.repeat([0, 1], 36).tolist()
    session = plates.session(
        columns | {"displacement": np.zeros(72)}, 1e-6, "offset", ["EXX"], None, "X", "Y", setup=setup
    )
    found, sense = approaches(session), np.tile(np.repeat([1.0, -1.0], 9), 2)
    np.testing.assert_array_equal(found["dir_x"], np.where(np.isnan(columns["x"]), 0.0, np.append(sense, still)))
    np.testing.assert_array_equal(found["dir_y"], np.append(still, sense))


def test_rows_of_a_plate_by_turns_from_either_side() -> None:
    """Each place is read from one side, and each position of X from both; rows that all begin at one side are not."""
    rows, x = np.repeat(PLACES, 9), np.concatenate([PLACES[:: (-1) ** k] for k in range(9)])
    columns = {
        "x": x,
        "y": rows,
        "gx": np.ones(81),
        "gy": np.zeros(81),
        "gz": np.zeros(81),
        "displacement": np.zeros(81),
    }
    found = approaches(plates.session(columns, 1e-6, "offset", ["EXX"]))
    assert set(found) == {"dir_x"}
    inside = (x > 0.0) & (x < 0.4)
    np.testing.assert_array_equal(found["dir_x"][inside], np.repeat((-1.0) ** np.arange(9), 9)[inside])
    assert not approaches(plates.session({**columns, "x": np.tile(PLACES, 9)}, 1e-6, "offset", ["EXX"]))


@pytest.mark.parametrize("folder", ["rotary_axis", "tracking_2d"])
def test_what_was_recorded_is_inferred(folder: str) -> None:
    session = read_session(DATA / folder)
    inferred = approaches(unrecorded(session))
    for name, sense in inferred.items():
        np.testing.assert_array_equal(sense, session.readings.columns[name])
    if folder == "tracking_2d":
        assert set(inferred) == {"dir_x", "dir_y"}


@pytest.mark.parametrize(
    "session",
    [
        line(PLACES, PLACES, repeat=True),
        line(np.random.default_rng(1).permutation(PLACES), np.random.default_rng(2).permutation(PLACES)),
        unrecorded(simulate(SimulationSpec(plan=PRESETS["probing_cross"], seed=1)).session),
    ],
    ids=["one_way", "any_order", "probe"],
)
def test_none_where_nobody_came_from_either_side(session: Session) -> None:
    assert not approaches(session)


def test_a_reversal_without_recorded_senses() -> None:
    session = line(*[PLACES, PLACES[::-1]] * 4, lost=5e-6)
    assert "dir_x" not in session.readings.columns
    (says,) = suspicions([session])
    assert says.startswith("dir_x was not recorded")
    senses = build_model(session)[0].observations.readings.columns["dir_x"]
    recorded = plates.with_columns(session, dir_x=senses)
    assert not suspicions([recorded])
    found, known = diagnose(session), diagnose(recorded)
    assert found.accepted == known.accepted == ("backlash_x",)
    assert found.search.of("backlash_x").sizes == known.search.of("backlash_x").sizes


def test_advice_is_given_where_readings_were_set_aside() -> None:
    session = line(*[PLACES, PLACES[::-1]] * 4, lost=5e-6)
    displacement = session.readings.displacement.copy()
    displacement[20] += 1e-4
    found = diagnose(session.with_readings(replace(session.readings, displacement=displacement)))
    assert [one.row for one in found.gross_errors] == [20] and found.accepted == ("backlash_x",)
    assert what_to_measure(found).dominant is not None


def test_whence_the_first_readings_come_nothing_says() -> None:
    """Corners read one after the other, four times: each is approached from one side, but for where the first began."""
    x, y = np.tile([0.0, 0.2, 0.2, 0.0], 4), np.tile([0.0, 0.0, 0.2, 0.2], 4)
    up = {"gz": 1.0}
    assert not approaches(plates.session({"x": x, "y": y, **up, "displacement": 1e-6 * x}, 1e-6, "none", ["EZX"]))
