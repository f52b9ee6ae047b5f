# SPDX-License-Identifier: Apache-2.0
"""Directions and setups that scatter differently: each has its own noise, and those that scatter alike have one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.arrays import rms
from machine_tool_calibration.diagnosis.compare import compare
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify, identify_sessions
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.reports.identification import goodness_of_fit
from machine_tool_calibration.session.description import StandardUncertainty
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.session import Session

from .. import plates

DATA = Path(__file__).parents[1] / "data"

PLACES, REPEATS = np.linspace(0.0, 0.5, 11), 5
TRUE = 1e-6 * np.random.default_rng(3).normal(size=(2, 11)) * 10.0


def read(noise: tuple[float, float], seed: int = 0) -> tuple[Session, np.ndarray]:
    """X read along x and along y by two instruments, and which direction each reading is of."""
    along = np.tile([0, 1], 11 * REPEATS)
    place = np.tile(np.repeat(np.arange(11), 2), REPEATS)
    rng = np.random.default_rng(seed)
    columns = {
        "x": PLACES[place],
        "y": 0.0 * place,
        "z": 0.0 * place,
        "gx": 1.0 - along,
        "gy": along,
        "gz": 0.0 * place,
    }
    columns["displacement"] = TRUE[along, place] + np.array(noise)[along] * rng.normal(size=len(place))
    repeat = np.repeat(np.arange(REPEATS), 22)
    return plates.session(columns, 1e-6, "none", ["EXX", "EYX"], repeat), along


def uncertainty(found: Result, table: str) -> float:
    return float(np.mean(found.error_map.content["tables"][table]["value_u"]))


def test_each_direction_has_the_uncertainty_of_its_own_instrument() -> None:
    covered = []
    for seed in range(20):
        found = identify(read((2e-6, 20e-6), seed)[0])
        assert uncertainty(found, "EXX") == pytest.approx(2e-6 / np.sqrt(REPEATS), rel=0.4)
        assert uncertainty(found, "EYX") == pytest.approx(20e-6 / np.sqrt(REPEATS), rel=0.4)
        tables = found.error_map.content["tables"]
        off = [
            np.abs(tables[name]["value"] - TRUE[k]) / tables[name]["value_u"] for k, name in enumerate(("EXX", "EYX"))
        ]
        covered.append(np.array(off) < 2.0)
    for share in np.mean(covered, axis=(0, 2)):
        assert 0.9 < share < 0.99


def test_a_gross_error_of_the_quiet_direction_is_found_beside_the_noisy_one() -> None:
    session, _ = read((2e-6, 20e-6))
    wrong = session.readings.displacement.copy()
    wrong[0] += 30e-6
    found = identify(plates.with_columns(session, wrong))
    assert [entry.row for entry in found.rejected] == [0]


def test_what_each_direction_scatters_by_is_said() -> None:
    document = identify(read((2e-6, 20e-6))[0]).document()
    each = document["error_map"]["scatter"]["each"]["along"]
    assert each["x"] == pytest.approx(2e-6, rel=0.3)
    assert each["y"] == pytest.approx(20e-6, rel=0.3)
    assert "µm along x, " in goodness_of_fit(document)


@pytest.fixture(scope="module")
def three_setups() -> Session:
    """Of one place, so that setups cannot be told by places: they scatter by 1, 1 and 30 µm."""
    rng, setup = np.random.default_rng(1), np.repeat([0, 1, 2], 12)
    columns = {key: np.zeros(36) for key in "xyz"}
    columns["displacement"] = np.array([1e-6, 1e-6, 30e-6])[setup] * rng.normal(size=36)
    return plates.session(columns, 1e-6, "offset", (), None, "a", "b", "c", setup=setup.tolist())


def test_setups_that_scatter_differently(three_setups: Session) -> None:
    found = {p.name: p.standard_uncertainty for p in identify(three_setups).parameters}
    assert max(found["a.offset"], found["b.offset"]) < 1e-6
    assert found["c.offset"] == pytest.approx(30e-6 / np.sqrt(12), rel=0.5)


def test_what_was_declared_stays_what_it_was(three_setups: Session) -> None:
    """Readings count by their own scatter, and are held against what was declared."""
    found = compare(three_setups)
    ratio = {name: np.sqrt(value) for name, value in found.setups.set_index("name")["reduced_chi_square"].items()}
    assert max(ratio["a"], ratio["b"]) < 1.5
    assert ratio["c"] == pytest.approx(30.0, rel=0.5)
    assert set(found.residuals["u_declared"]) == {1e-6}
    assert found.noise.declared == pytest.approx(1e-6)


def test_directions_that_scatter_alike_have_one_noise() -> None:
    told = [build_model(read((3e-6, 3e-6), seed)[0])[0].noise for seed in range(30)]
    apart = [noise.factor for noise in told if noise is not None]
    assert len(apart) <= 6
    assert all(np.ptp(np.log(noise)) < 0.3 for noise in apart)


def test_rounded_readings_are_not_without_noise() -> None:
    """All readings of X agree to the micrometre that they are rounded to."""
    session, along = read((0.1e-6, 5e-6))
    values = session.readings.displacement
    session = plates.with_columns(session, np.where(along == 0, np.round(values, 6), values))
    each = identify(session).document()["error_map"]["scatter"]["each"]["along"]
    assert each["x"] > 1e-6 / np.sqrt(12) / 2


def test_repeats_that_agree_better_than_declared_make_no_reading_better() -> None:
    """Declared is what Y scatters by; X, which repeats within a tenth of it, may be off by as much everywhere."""
    session, _ = read((2e-6, 20e-6))
    said = session.description.model_copy(update={"standard_uncertainty": StandardUncertainty(displacement=20e-6)})
    found = identify(replace(session, description=said))
    noise = found.fit.model.noise
    assert noise is None or noise.factor.max() < 1.1
    assert uncertainty(found, "EXX") == pytest.approx(20e-6 / np.sqrt(REPEATS), rel=0.05)


@pytest.mark.long
def test_in_several_sessions_each_reading_counts_by_its_own_noise() -> None:
    """One session reads X well and Y badly, twice, another one both well, ten times: that one leads."""
    off, sure = [], []
    for seed in range(12):
        few, many = (read(noise, 100 * seed + k)[0] for k, noise in enumerate(((1e-6, 20e-6), (1e-6, 1e-6))))
        keep = few.readings.repeat < 2
        few = few.with_readings(few.readings.select(keep))
        joint = identify_sessions(FitRequest((few, many), ("few", "many")))
        table = joint.error_map.content["tables"]["EXX"]
        off.append(table["value"] - TRUE[0])
        sure.append(table["value_u"])
    assert rms(np.array(off).ravel()) < 1.25e-6 / np.sqrt(REPEATS + 2)
    assert 0.7 < rms((np.array(off) / np.array(sure)).ravel()) < 1.3


@pytest.mark.long
def test_an_effect_in_one_direction_is_none_of_its_noise() -> None:
    """A backlash of X that every run repeats is found beside a noisy Y, and X keeps its own noise."""
    for seed in range(3):
        session, along = read((1e-6, 10e-6), seed)
        sense = np.where(session.readings.repeat % 2 == 0, 1.0, -1.0)
        moved = session.readings.displacement - np.where(along == 0, 3e-6 * sense, 0.0)
        found = diagnose(plates.with_columns(session, moved, dir_x=sense))
        assert found.accepted in (("backlash_x",), ("lost_motion_x",))


def test_a_place_that_one_direction_lacks_is_not_zero() -> None:
    session, along = read((1e-6, 1e-6))
    lost = np.where((along == 1) & (session.readings.columns["x"] == 0.0), np.nan, session.readings.displacement)
    found = identify(plates.with_columns(session, lost))
    assert np.isnan(found.error_map.error[0, 1])
    assert np.isfinite(found.error_map.error[1:, 1]).all()


def test_directions_that_only_setups_make_differ_are_not_named() -> None:
    """Beams at an angle to the axes have no direction of their own; what differs is the setup."""
    rng, setup = np.random.default_rng(0), np.tile(np.repeat([0, 1], 11), 6)
    place = np.tile(np.arange(11), 12)
    columns = {"x": PLACES[place], "y": 0.0, "z": 0.0, "gz": 0.0 * place}
    columns |= {"gx": np.where(setup == 0, 0.8, 0.6), "gy": np.where(setup == 0, 0.6, 0.8)}
    columns["displacement"] = np.array([1e-6, 15e-6])[setup] * rng.normal(size=132)
    session = plates.session(columns, 1e-6, "none", ["EXX", "EYX"], np.repeat(np.arange(6), 22), "A", "B", setup=setup)
    (way,) = identify(session).document()["error_map"]["scatter"]["each"].items()
    assert way[0] == "setup"
    assert way[1] == {"A": pytest.approx(1e-6, rel=0.3), "B": pytest.approx(15e-6, rel=0.3)}


def test_what_is_said_of_the_declared_uncertainty_is_against_what_was_declared() -> None:
    """X scatters by 1, Y by 10 times the declared uncertainty: that each counts by its own makes neither declared."""
    measured, _ = read((1e-6, 10e-6))
    joint = identify(measured).joint
    assert joint.reduced_chi_square == pytest.approx(50.5, rel=0.3)
    assert joint.p_value < 1e-6 and joint.variance == pytest.approx(1.0, abs=0.3)
    assert compare(measured).overall.reduced_chi_square == joint.reduced_chi_square


def test_a_part_of_the_readings_counts_as_it_does_among_all() -> None:
    """What a part says of its noise by itself would be taken for evidence for or against an effect."""
    session, _ = read((1e-6, 5e-6))
    part = session.without(session.readings.columns["x"] < 0.25)
    whole, own = build_model(session)[0], build_model(part)[0]
    assert not np.allclose(own.sigma, whole.sigma[-len(own.sigma) :])
    mine = np.isin(session.readings.row, part.readings.row)
    np.testing.assert_array_equal(own.drawn_as(whole).sigma, whole.sigma[mine])
    widened = whole.drawn_as(own).sigma
    np.testing.assert_array_equal(widened[mine], own.sigma)
    np.testing.assert_array_equal(widened[~mine], whole.sigma[~mine])
    plain = build_model(read((1e-6, 1e-6))[0])[0]
    np.testing.assert_array_equal(whole.drawn_as(plain).sigma, plain.sigma)


def test_readings_that_scatter_less_than_declared_are_not_said_to_be_used() -> None:
    """Of two degrees of freedom the uncertainties exceed the declared one a little, and are not of the scatter."""
    x, read = np.array([0.0, 0.1, 0.2, 0.3, 0.0, 0.2]), 1e-6 * np.array([0.0, 1.0, 2.0, 1.0, 0.4, 1.7])
    columns = {"x": x, "displacement": read}
    found = identify(plates.session(columns, 5e-7, "none", ("EXX",))).error_map.content["scatter"]
    assert found["found"] < found["declared"] and found["factor"] > 1.0
    assert found["uncertainties_from"] == "declared"


@pytest.mark.parametrize(("example", "noisy"), [("tracking_2d", 1), ("step_diagonal", 1)])
def test_a_setup_of_another_method_counts_by_its_own_noise(example: str, noisy: int) -> None:
    """Read there and back once, or twice from one side, with runs that bend: one setup scatters five times as much."""
    session = read_session(DATA / example)
    readings, sigma = session.readings, session.sigma
    rng, more = np.random.default_rng(1), readings.setup == noisy
    bends = 15.0 * sigma * np.cos(readings.columns["time"] / np.ptp(readings.columns["time"]) * 20.0)
    bent = build_model(plates.with_columns(session, readings.displacement + bends))[0]
    assert bent.noise is None or bent.noise.factor.max() < 1.3
    wide = readings.displacement + bends + np.sqrt(24.0) * sigma * more * rng.normal(size=len(more))
    found = identify(plates.with_columns(session, wide))
    factor = found.fit.model.sigma / found.fit.model.declared_sigma
    assert np.median(factor[more]) == pytest.approx(5.0, rel=0.4)
    assert np.median(factor[~more]) < 2.0
    name = session.setup_ids[noisy]
    assert found.document()["error_map"]["scatter"]["each"]["setup"][name] == pytest.approx(5.0 * sigma, rel=0.5)
    assert f"in setup {name}" in goodness_of_fit(found.document())


def test_a_gross_error_is_no_noise_of_its_setup() -> None:
    session = read_session(DATA / "tracking_2d")
    wrong = session.readings.displacement.copy()
    wrong[30] += 60.0 * session.sigma
    found = build_model(plates.with_columns(session, wrong))[0].noise
    assert found is None or found.factor.max() < 1.3


def marks(noise: np.ndarray, seed: int, slope: float = 0.0) -> Session:
    """Marks on a line, each of which scatters by its own (k,), m, in 24 runs whose slopes differ by `slope`, m."""
    rng, place, repeat = np.random.default_rng(seed), np.tile(np.arange(9), 24), np.repeat(np.arange(24), 9)
    columns = {"x": 0.05 * place, "y": 0.0 * place, "z": 0.0 * place}
    columns["displacement"] = noise[place] * rng.normal(size=216) + slope * rng.normal(size=24)[repeat] * (
        place / 4.0 - 1
    )
    return plates.session(columns, 1e-6, "none", ["EXX"], repeat)


def test_a_mark_that_is_hardly_seen_has_noise_of_its_own() -> None:
    noise = np.where(np.arange(9) == 3, 15e-6, 1e-6)
    for seed in range(5):
        found = identify(marks(noise, seed))
        assert len(found.rejected) <= 1
        u = found.error_map.uncertainty[:, 0]
        assert u[3] == pytest.approx(15e-6 / np.sqrt(24), rel=0.5)
        assert np.median(u) == pytest.approx(1e-6 / np.sqrt(24), rel=0.5)
    assert "at (150, 0, 0) mm" in goodness_of_fit(found.document())


def test_places_that_slopes_move_more_are_no_noisier() -> None:
    told = [build_model(marks(np.full(9, 1e-6), seed, slope=10e-6))[0].noise for seed in range(5)]
    assert all(noise is None or noise.factor.max() < 1.3 for noise in told)


def test_a_reversal_is_no_noise_whether_its_side_was_recorded_or_not() -> None:
    """X there and back in two setups, of which one senses its play: with and without the column of the direction."""
    place = np.tile(np.concatenate([np.arange(12), np.arange(11, -1, -1)]), 2)
    setup, sense = np.repeat([0, 1], 24), np.tile(np.repeat([1.0, -1.0], 12), 2)
    for seed in range(5):
        columns = {"x": 0.05 * place, "y": 0.0 * place, "z": 0.0 * place, "gx": 1.0 - 0.9 * setup, "gy": 0.9 * setup}
        noise = 1e-6 * np.random.default_rng(seed).normal(size=48)
        columns |= {"gz": 0.0 * place, "displacement": -30e-6 * sense * columns["gx"] + noise}
        session = plates.session(columns, 1e-6, "offset", ["EXX", "EYX"], None, "A", "B", setup=setup)
        for told in (session, plates.with_columns(session, dir_x=sense)):
            found = build_model(told)[0].noise
            assert found is None or found.factor.max() < 1.3
