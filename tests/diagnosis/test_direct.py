# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of plates and axes as workshops measure them.
Diagnosis of places that were read once each: axes one at a time, and a machine that is no three rigid axes.
"""

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.diagnosis.search.effect_search import led_by_places
from machine_tool_calibration.diagnosis.search.structure import structure_candidates
from machine_tool_calibration.effects.thermal_lag import followed
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.result import effect_estimates
from machine_tool_calibration.model.widening import BESIDE
from machine_tool_calibration.planning.what_to_measure import Advice
from machine_tool_calibration.reports.verdict import next_step, verdict_words
from machine_tool_calibration.residuals.noise import noise_of
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, MachineSpec, SimulationSpec, simulate
from machine_tool_calibration.words import say

from .. import plates
from ..told import keys


@pytest.mark.long
def test_scale_then_different_scales_and_squareness(many: Any) -> None:
    both = 0
    some = many.part(0.4)
    for seed in range(some.count):
        session, _ = plates.plate(seed, scales=(4e-5, 2e-5), square=5e-5)
        found = diagnose(session)
        assert found.verdict == "missing_effect"
        assert "C0Y" in found.accepted
        # Two numbers are needed for two scales: which of the three they are is a matter of words.
        told = {"scale", "scale_x", "scale_y"} & set(found.accepted)
        assert told
        both += len(told) == 2
    # Where the scatter hides how the scales differ, one is named for both.
    assert some.count - both <= some.at_most(0.05)


@pytest.mark.long
def test_one_scale_only(many: Any) -> None:
    some = many.part(0.3)
    found = [diagnose(plates.plate(seed, holes=150, scales=(4e-5, 4e-5))[0]).accepted for seed in range(some.count)]
    assert sum(accepted != ("scale",) for accepted in found) <= some.at_most(0.05)


@pytest.mark.long
@pytest.mark.parametrize("given", [{}, {"declared": 1e-7}, {"declared": 3e-5}, {"repeats": 4, "holes": 120}])
def test_plates_in_which_nothing_is_missing(given: dict[str, float], many: Any) -> None:
    some = many.part(0.2)
    verdicts = [diagnose(plates.plate(seed, **{"holes": 150, **given})[0]).verdict for seed in range(some.count)]
    assert sum(verdict not in ("adequate", "outliers") for verdict in verdicts) <= some.at_most(0.05)


@pytest.mark.long
def test_rows_that_scatter_together_are_no_effect(many: Any) -> None:
    some = many.part(0.3)
    every = [plates.plate(seed, rows=True, row_scatter=3e-6)[0] for seed in range(some.count)]
    assert sum(bool(diagnose(session).accepted) for session in every) <= some.at_most(0.05)


@pytest.mark.long
def test_an_effect_that_leaves_most_of_what_repeats_show_is_not_what_is_missing() -> None:
    """Poses that were read three times deviate by 20 µm each, of which a scale explains a tenth of the squares."""
    found = diagnose(plates.plate(1, holes=150, repeats=3, drilled=20e-6, scales=(4e-5, 4e-5), tails=None)[0])
    first, scaled = found.search.fit.reduced_chi_square, found.search.of("scale")
    assert scaled.probability > 0.9
    assert found.noise.from_repeats == pytest.approx(1e-6, rel=0.2)
    assert scaled.rms_after > 0.9 * np.sqrt(first) * found.noise.declared
    assert (found.verdict, found.accepted, found.likely[:1]) == ("unexplained", (), ("scale",))
    # Where it is half of what repeats show, it is.
    half = diagnose(plates.plate(1, holes=150, repeats=3, scales=(4e-5, 4e-5), tails=None)[0])
    assert (half.verdict, half.accepted) == ("missing_effect", ("scale",))


@pytest.mark.long
def test_a_scatter_that_nothing_tells_from_the_places_asks_for_repeats(monkeypatch: pytest.MonkeyPatch) -> None:
    """Holes that were read once each and scatter by far more than was declared."""
    found = diagnose(plates.plate(2, holes=150, declared=2e-7, tails=None)[0])
    assert (found.verdict, found.noise.from_repeats) == ("adequate", None)
    told = [key for words in verdict_words(found, {}, Advice()) for key in keys(words)]
    assert told[0] == "diagnosis.no_pattern" and "diagnosis.good_enough" not in told
    assert keys(next_step(found, Advice())) == ["next.repeats"]
    # Structure that is sure and too small to matter is no scatter.
    small = replace(found, search=replace(found.search, unknown=0.97, nothing=0.01))
    with monkeypatch.context() as patched:
        patched.setattr(Diagnosis, "left", (SimpleNamespace(share=0.2),))
        told = [key for words in verdict_words(small, {}, Advice()) for key in keys(words)]
    assert told[:3] == ["diagnosis.no_effect", "diagnosis.residual", "diagnosis.small_in_map"]
    repeated = diagnose(plates.plate(2, holes=150, repeats=3, declared=2e-7, tails=None)[0])
    told = [key for words in verdict_words(repeated, {}, Advice()) for key in keys(words)]
    assert told[0] == "diagnosis.places_only" and "shape.places_differ" in told and repeated.left
    assert keys(next_step(repeated, Advice())) == ["next.places"]
    repeats_too = replace(repeated, noise=replace(repeated.noise, as_read=2e-3))
    assert keys(next_step(repeats_too, Advice())) == ["next.scatter"]


@pytest.mark.long
def test_far_holes_are_named() -> None:
    session, far = plates.plate(3, holes=150, far=4, scales=(4e-5, 4e-5), tails=None)
    found = diagnose(session)
    assert [o.row for o in sorted(found.gross_errors, key=lambda o: o.row)] == far
    assert found.accepted == ("scale",)


@pytest.mark.long
def test_repeats_in_a_plane_that_is_not_zero() -> None:
    """The mean of equal heights is that height, to the last bit."""
    session, _ = plates.plate(2, repeats=3, holes=100, scales=(4e-5, 4e-5))
    readings = session.readings
    lifted = session.with_readings(replace(readings, columns={**readings.columns, "z": np.full(len(readings), 0.05)}))
    found = diagnose(lifted)
    assert found.accepted == ("scale",)
    assert np.ptp(found.search.fit.fits[0].model.observations.position[:, 2]) == 0.0


@pytest.mark.long
def test_far_holes_beside_each_other_are_something_else() -> None:
    """x and y of a hole alternate in the list: neighbours are those of the same direction."""
    session, _ = plates.plate(4, tails=None, holes=100)
    readings = session.readings
    change = np.zeros(len(readings))
    along_y = np.flatnonzero(readings.columns["gy"] == 1.0)
    change[along_y[40:49]] = 2e-4
    found = diagnose(session.with_readings(replace(readings, displacement=readings.displacement + change)))
    assert found.gross_errors == ()


@pytest.mark.long
def test_axis_with_backlash_and_an_error_of_no_simple_shape() -> None:
    for seed in range(3):
        session = plates.axis(seed, backlash=2e-6, wander=2e-6, scale=2e-5, between=2e-7)
        found = diagnose(session)
        assert found.verdict == "missing_effect"
        assert {"EXX", "backlash_x"} <= set(found.accepted) <= {"scale", "EXX", "backlash_x"}


@pytest.mark.long
def test_passes_that_differ_are_no_drift(many: Any) -> None:
    some = many.part(0.5)
    every = [plates.axis(seed, between=5e-7, terms=("EXX",)) for seed in range(some.count)]
    assert sum(bool(diagnose(session).accepted) for session in every) <= some.at_most(0.05)


@pytest.mark.long
def test_passes_of_an_axis_that_slips_are_what_is_said_first() -> None:
    session = plates.axis(5, between=2e-5, terms=("EXX",))
    found = diagnose(session)
    assert (found.verdict, found.accepted) == ("adequate", ())
    told = " ".join(verdict_words(found, {}, Advice(), brief=True))
    assert "passes over the axis differ among themselves by" in told
    assert "More runs make the uncertainty smaller" in next_step(found, Advice())
    columns = {name: values for name, values in session.readings.columns.items() if name != "time"}
    untimed = diagnose(session.with_readings(replace(session.readings, columns=columns)))
    assert keys(next_step(untimed, Advice())) == ["next.runs_untimed"]
    still = diagnose(plates.axis(5, declared=5e-7, terms=("EXX",)))
    assert keys(next_step(still, Advice())) == ["next.nothing"]
    doubtful = replace(still, search=replace(still.search, nothing=0.3, unknown=0.0))
    assert keys(next_step(doubtful, Advice())) == ["next.may_be_missing"]


@pytest.mark.long
def test_play_of_the_other_sign_is_named_with_its_sign() -> None:
    """Directions of approach that were recorded the wrong way round."""
    spec = SimulationSpec(plan=PRESETS["iso230_2"], seed=5, effects=(FlawSpec(id="lost_motion_x", amplitude=2e-6),))
    session = simulate(spec).session
    assert diagnose(session).accepted == ("lost_motion_x",)
    columns = session.readings.columns
    turned = replace(session.readings, columns={**columns, "dir_x": -columns["dir_x"]})
    found = diagnose(session.with_readings(turned))
    assert (found.verdict, found.accepted) == ("missing_effect", ("lost_motion_x",))
    assert found.search.of("lost_motion_x").sizes[0].value < 0.0


def test_a_frame_may_warm_up_by_tenths_of_a_millimetre() -> None:
    """Read by a switch at one place, as on printers and wood working machines."""
    time = 60.0 * np.arange(300)
    warm = 3e-4 * (1.0 - np.exp(-time / 4000.0)) + 5e-6 * np.random.default_rng(3).normal(size=300)
    columns = {"time": time, "z": 0.0, "gz": 1.0, "displacement": warm}
    found = diagnose(plates.session(columns, 5e-6, "offset", (), None, "top"))
    assert (found.verdict, found.accepted) == ("missing_effect", ("warmup_z",))
    assert {"dead_path", "refractive_index"} <= set(found.excluded)


def frame_that_warms(time: Array, moved: Array, **temperatures: Array) -> Session:
    """A frame read by a switch at one place."""
    read = moved + 2e-6 * np.random.default_rng(1).normal(size=len(time))
    columns = {"time": time, "z": 0.0, "gz": 1.0, **temperatures, "displacement": read}
    return plates.session(columns, 2e-6, "offset", (), None, "top")


@pytest.mark.long
def test_effects_that_take_each_other_back_are_not_named() -> None:
    """Half a millimetre of warm-up that the cold end of the frame takes back but for some hundredths."""
    time = 8.0 * np.arange(300)
    chamber = 26.0 + 12.0 * (1.0 - np.exp(-time / 800.0))
    moved = 5e-4 * (1.0 - np.exp(-time / 1000.0)) - 40e-6 * (followed(time, chamber, 60.0) - 26.0)
    found = diagnose(frame_that_warms(time, moved, temperature_z=chamber))
    assert (found.verdict, found.accepted) == ("unexplained", ())
    assert "take back" in found.refused["warmup_z"]
    # What does some of the same does not take its place.
    assert "since warmup_z cannot be it" in found.refused["thermal_lag_z"]


def frame_over_a_bed() -> tuple[Array, Array, dict[str, Array]]:
    """Times, how a frame moves that follows bed and nozzle, and the chamber's sensor some, and their temperatures."""
    time = 7.0 * np.arange(300)
    bed = followed(time, np.interp(time, [0, 300, 480, 1500, 2000], [26.0, 26.0, 70.0, 70.0, 60.0]), 30.0)
    nozzle = followed(time, np.interp(time, [0, 300, 420, 1500, 1900], [30.0, 30.0, 220.0, 220.0, 80.0]), 20.0)
    chamber = 26.0 + 8.0 * (followed(time, bed, 900.0) - 26.0) / 44.0
    moved = 1e-6 * (1.3 * chamber + 0.64 * followed(time, bed, 50.0) + 0.156 * followed(time, nozzle, 120.0))
    return time, moved, {"temperature_z": chamber, "bed": bed, "nozzle": nozzle}


@pytest.mark.long
def test_a_lag_that_explains_less_than_expansion_without_one_is_not_named() -> None:
    time, moved, warm = frame_over_a_bed()
    # Names with spaces are those of no effect.
    unnamed = {"temperature_z": warm["temperature_z"], "the bed": warm["bed"], "the nozzle": warm["nozzle"]}
    found = diagnose(frame_that_warms(time, moved, **unnamed))
    # The expansion is there; the rest follows the bed, and a drift may be in it.
    assert found.verdict == "missing_effect" and "thermal_expansion_z" in found.accepted
    assert "thermal_lag_z" not in found.accepted
    assert any(left.covariate == "the bed" and left.share > 0.8 for left in found.left)


@pytest.mark.long
def test_a_frame_that_follows_bed_and_nozzle_has_both_named() -> None:
    time, moved, warm = frame_over_a_bed()
    found = diagnose(frame_that_warms(time, moved, **warm))
    assert set(found.accepted) == {"follows_late_bed_z", "follows_late_nozzle_z"}
    assert found.fits[-1].reduced_chi_square < 1.2


@pytest.mark.long
def test_reversal_of_no_simple_form_is_said_place_by_place() -> None:
    """Backlash, and beside it a reversal that differs from each place to the next: no wave in the order."""
    session = plates.axis(3, backlash=1e-5, declared=5e-7, terms=("EXX",), datum="offset")
    readings = session.readings
    place = np.round(readings.columns["x"] / 0.05).astype(int)
    own = 1e-6 * np.array([2.0, -1.0, -3.0, 3.0, -4.0, 4.0, 0.0, -4.0, 2.0, 3.0, -2.0])
    moved = readings.displacement - own[place] * readings.columns["dir_x"]
    columns = {name: values for name, values in readings.columns.items() if name != "time"}
    found = diagnose(session.with_readings(replace(readings, displacement=moved, columns=columns)))
    assert found.verdict == "missing_effect" and set(found.accepted) <= {"backlash_x", "lost_motion_x"}
    assert (found.left[0].covariate, found.left[0].share > 0.3) == ("dir_x and x", True)
    assert "from place to place" in found.left[0].shape


def test_meshes_that_differ_by_tilts_are_said_to() -> None:
    """A bed that was probed five times in some weeks: each time it lay otherwise."""
    x, y = (part.reshape(-1) for part in np.meshgrid(np.linspace(0.0, 0.3, 6), np.linspace(0.0, 0.3, 6)))
    rng, n, meshes = np.random.default_rng(5), len(x), 5
    _one, none = np.ones(n * meshes), np.zeros(n * meshes)
    setup = np.repeat(np.arange(meshes), n)
    columns = {"x": np.tile(x, meshes), "y": np.tile(y, meshes), "z": none, "gz": 1.0}
    tilt = 2e-4 * rng.normal(size=(2, meshes))[:, setup]
    columns["displacement"] = tilt[0] * columns["x"] + tilt[1] * columns["y"] + 5e-6 * rng.normal(size=n * meshes)
    bed = plates.session(columns, 5e-6, "offset", ("EZX", "EZY"), none.astype(np.int64), "0")
    setups = tuple(bed.description.setups[0].model_copy(update={"id": f"{k}"}) for k in range(meshes))
    description = bed.description.model_copy(update={"setups": setups})
    found = diagnose(replace(bed, description=description, readings=replace(bed.readings, setup=setup)))
    assert (found.verdict, found.accepted) == ("unexplained", ())
    first = found.search.structure[0]
    assert (first.covariate, first.share > 0.9) == ("setup", True)


@pytest.mark.parametrize(("declared", "again"), [(1e-6, False), (1e-5, True), (3e-5, False)])
def test_tilts_are_said_beside_a_form_that_all_meshes_have(declared: float, again: bool) -> None:
    """Whatever was declared, and as setups or as repeats of one: what all have in common is no matter of tilts."""
    rng, at = np.random.default_rng(3), np.linspace(0.01, 0.22, 4)
    x, y = (np.tile(part.ravel(), 2) for part in np.meshgrid(at, at))
    mesh = np.repeat([0, 1], 16)
    form = 27e-6 * np.tile(rng.normal(size=16), 2)
    tilt = np.where(mesh == 1, 1.0, -1.0) * 3e-4 * (x + y - 0.23)
    columns = {"x": x, "y": y, "z": 0.0, "gz": 1.0, "displacement": form + tilt + 1e-5 * rng.normal(size=32)}
    names, setup = (("A",), None) if again else (("A", "B"), mesh.tolist())
    bed = plates.session(columns, declared, "offset", ("EZX", "EZY"), mesh if again else None, *names, setup=setup)
    found = diagnose(bed)
    assert (found.verdict, found.accepted) == ("unexplained", ())
    first = found.search.structure[0]
    assert (first.covariate, keys(first.shape)) == ("repeat" if again else "setup", ["shape.slopes"])


def part_read_in_setups(seed: int, yaw: float) -> Session:
    """A plate of 36 holes in three setups: each hole is off by 3 um, x and y are read with 1 um; ECX of this RMS, m."""
    rng, at, setups = np.random.default_rng(seed), np.linspace(0.0, 0.3, 6), 3
    x, y = (np.tile(part.ravel(), 2 * setups) for part in np.meshgrid(at, at))
    setup, along_x = np.repeat(np.arange(setups), 72), np.tile(np.repeat([1.0, 0.0], 36), setups)
    lever = along_x * (0.15 - y) * ((x / 0.3 - 0.5) ** 2 + 0.5 * (x / 0.3 - 0.5) ** 3)
    tables = along_x * 3e-6 * np.sin(9 * x) + (1 - along_x) * (2e-6 * np.cos(8 * y) - 1e-5 * x)
    holes = np.tile(3e-6 * rng.normal(size=72), setups) + 3e-6 * rng.normal(size=setups)[setup]
    read = tables + holes + yaw * lever / np.sqrt(np.mean(lever**2)) + 1e-6 * rng.normal(size=len(x))
    columns = {"x": x, "y": y, "z": 0.0, "gx": along_x, "gy": 1 - along_x, "displacement": read}
    terms = ("EXX", "EYX", "EXY", "EYY")
    return plates.session(columns, 1e-6, "offset", terms, None, "A", "B", "C", setup=setup.tolist())


def test_holes_that_are_off_in_every_setup_are_no_effect_and_hide_none() -> None:
    """Each hole has its own, the same in all: it had been "unexplained" nearly always, and ECX in one of eight."""
    for seed in range(3):
        found = diagnose(part_read_in_setups(seed, 0.0))
        assert (found.verdict, found.accepted) == ("adequate", ())
    found = [diagnose(part_read_in_setups(seed, 2.7e-6)).accepted for seed in range(3)]
    assert found.count(("ECX",)) >= 2 and set(found) <= {("ECX",), ()}


def test_series_that_differ_are_not_to_be_read_more_often() -> None:
    """A probe at one place, 99 and 53 times, 11 um apart: twice the readings leave U as it is."""
    setup, rng = np.repeat([0, 1], [99, 53]), np.random.default_rng(2)
    read = 1.1e-5 * setup + 1.8e-5 * rng.normal(size=152)
    columns = {"x": 0.0 * setup, "gz": 1.0, "displacement": read}
    again = np.r_[0:99, 0:53]
    found = diagnose(plates.session(columns, 1.8e-5, "none", ("EZZ",), again, "A", "B", setup=setup.tolist()))
    assert "next.setups" in keys(next_step(found, Advice()))


@pytest.mark.long
@pytest.mark.parametrize("what", ["places", "runs", "zone"])
def test_scatter_of_places_is_said_where_their_repeats_agree_and_nothing_is_alike(what: str) -> None:
    session = simulate(SimulationSpec(plan=PRESETS["grid_plate"].model_copy(update={"repeats": 4}), seed=3)).session
    readings, rng = session.readings, np.random.default_rng(3)
    x, y = readings.columns["x"], readings.columns["y"]
    place = np.unique(np.column_stack([x, y, readings.columns["gx"]]), axis=0, return_inverse=True)[1].ravel()
    change = {
        "places": 6.0 * rng.normal(size=place.max() + 1)[place],
        "runs": 6.0 * rng.normal(size=4)[readings.repeat] * (x - x.mean()) / x.std(),
        "zone": 12.0 * ((x > 0.5 * x.max()) & (y > 0.5 * y.max())),
    }[what]
    columns = {name: readings.columns[name] for name in ("x", "y", "gx", "gy", "gz")}
    moved = replace(readings, columns=columns, displacement=readings.displacement + session.sigma * change)
    told = " ".join(verdict_words(diagnose(session.with_readings(moved)), {}, Advice()))
    assert ("without a pattern" in told) == (what == "places")
    if what == "zone":
        assert "beside each other alike" in told or "depend on" in told or "The model lacks" in told


@pytest.mark.long
def test_a_zone_that_is_crossed_in_rows_is_a_matter_of_place_and_not_of_time() -> None:
    """Each row of a raster takes its time: a zone is a step in time as well, and the second run repeats it."""
    rng, side = np.random.default_rng(11), np.linspace(0.0, 0.4, 9)
    way = [(x, y, s) for k, y in enumerate(side) for s in (1 - 2 * (k % 2),) for x in side[::s]]
    x, y, sense = (np.tile(np.repeat(one, 2), 2) for one in np.array(way).T)
    g = np.tile([0, 1], 162)
    error = np.where(g == 0, 4e-6 * ((x > 0.21) & (y > 0.21)) + 2e-6 * np.sin(x / 0.06), 3e-6 * (y > 0.31))
    bump = 3e-6 * np.exp(-((x - 0.1) ** 2 + (y - 0.1) ** 2) / 0.003) * (g == 1)
    columns = {
        "x": x, "y": y, "gx": 1.0 - g, "gy": 1.0 * g, "gz": 0.0 * g, "dir_x": sense, "dir_y": np.ones(324),
        "time": np.repeat(np.arange(162) * 8.0, 2) + 120.0 * np.repeat([0, 1], 162),
        "displacement": error + bump + 0.25e-6 * rng.normal(size=324),
    }  # fmt: skip
    terms = ("EXX", "EYX", "EXY", "EYY", "ECX", "ECY", "C0Y")
    found = diagnose(plates.session(columns, 2.5e-7, "rigid", terms, np.repeat([0, 1], 162), "stage"))
    assert found.left and found.left[0].shape == "a zone of its own that begins at 225 mm, 225 mm"
    time, joint = replace(found.left[0], covariate="time", shape="a step"), found.with_found.joint
    assert led_by_places((time,), joint, [noise_of(own) for own in joint.fits])[0].covariate == "place"
    text = " ".join(verdict_words(found, {}, Advice()))
    assert "the model free (--model) gives every place" in text
    assert "depend on time" not in text


def in_space(position: np.ndarray, error: np.ndarray, terms: list[str], declared: float) -> Session:
    """Places (n, 3), m, and their deviations (n, 3) read along x, y and z."""
    n = len(position)
    columns = dict(zip("xyz", np.repeat(position, 3, axis=0).T, strict=True))
    columns |= dict(zip(("gx", "gy", "gz"), np.tile(np.eye(3), (n, 1)).T, strict=True))
    columns["displacement"] = error.reshape(-1)
    return plates.session(columns, declared, "rigid", terms, np.zeros(3 * n), "tracker")


def test_axes_that_cross_in_the_middle_of_their_travel_have_no_product() -> None:
    """A tracker at a stage of which one axis moves at a time, the others at zero."""
    along = np.linspace(-0.2, 0.2, 11)
    position = np.concatenate([along[:, None] * axis for axis in np.eye(3)])
    rng = np.random.default_rng(1)
    error = 1e-4 * position + 2e-5 * rng.normal(size=position.shape)
    session = in_space(position, error, ["EXX", "EYY", "EZZ"], 2e-5)
    pool = Pool(fit_models([build_model(session)[0]]))
    assert all(len(shaped.columns) for one in structure_candidates(pool) for shaped in one.shapes)
    assert diagnose(session).verdict in ("adequate", "missing_effect", "unexplained")


def places_of_arm(joints: np.ndarray) -> np.ndarray:
    """(n, 3) where an arm with two links ends that turns on a column, from its three angles (n, 3)."""
    turn, lift, bend = joints.T
    reach = 0.3 * np.cos(lift) + 0.35 * np.cos(lift + bend)
    height = 0.3 * np.sin(lift) + 0.35 * np.sin(lift + bend)
    return np.column_stack([reach * np.cos(turn), reach * np.sin(turn), height])


@pytest.mark.long
def test_what_explains_a_small_part_of_a_pattern_is_not_what_is_missing() -> None:
    """The errors of a jointed arm are those of its joints, of which error motions of three axes take up a little."""
    rng = np.random.default_rng(4)
    joints = np.column_stack([rng.uniform(-1.0, 1.0, 250), rng.uniform(0.3, 1.5, 250), rng.uniform(-2.2, -0.4, 250)])
    turn, lift, bend = joints.T
    off = 1e-3 * np.column_stack([np.sin(2 * turn + 3 * lift), 0.8 * np.sin(3 * lift), 0.8 * np.cos(2 * bend + turn)])
    error = places_of_arm(joints + off) - places_of_arm(joints)
    noise = 3e-5 * rng.normal(size=error.shape)
    session = in_space(np.round(places_of_arm(joints), 5), error + noise, ["EXX", "EYY", "EZZ"], 3e-5)
    found = diagnose(session)
    assert any(found.search.of(name).probability > 0.9 for name in found.search.accepted)
    assert found.fits[0].reduced_chi_square > 50.0
    assert (found.verdict, found.accepted) == ("unexplained", ())


def test_one_place_that_was_read_without_times_gets_an_answer() -> None:
    """There is nothing that readings could depend on."""
    read = 1e-5 * np.random.default_rng(3).normal(size=10)
    found = diagnose(plates.session({"x": 0 * read, "y": 0.0, "z": 0.0, "displacement": read}, 6e-6, "none", ["EXX"]))
    assert found.verdict == "adequate"


def test_of_what_slips_nothing_is_named_whose_size_may_be_zero() -> None:
    """One place read again and again, which something holds no longer from some voltage on."""
    rng, n = np.random.default_rng(113), 200
    voltage = 1.2 + np.arange(n) / n
    slips = np.cumsum(np.where((rng.random(n) < 0.1) & (voltage > 1.7), 25e-6 * rng.normal(size=n), 0.0))
    columns = {"x": 0.0, "y": 0.0, "z": 0.0, "time": 30.0 * np.arange(n), "voltage": voltage}
    columns["displacement"] = slips + 1e-6 * rng.normal(size=n)
    found = diagnose(plates.session(columns, 1e-6, "offset"))
    for name in found.accepted:
        sizes = effect_estimates(found.fits[-1], [name])
        assert any(abs(one.value) > 2.0 * one.standard_uncertainty for one in sizes), name


def test_what_one_place_is_off_by_is_no_warm_up() -> None:
    """Without a term or an offset there is nothing else that a constant could be, but an effect of the time."""
    for seed in range(4):
        read = 1e-6 + 1e-6 * np.random.default_rng(seed).normal(size=60)
        session = plates.session({"time": 60.0 * np.arange(60), "x": 0.0, "displacement": read}, 1e-6)
        found = diagnose(session)
        assert not found.accepted and found.verdict == "adequate"
        assert found.fitted[0].error_map.error[0, 0] == pytest.approx(1e-6, abs=4e-7)


def test_a_place_that_is_off_each_time_is_said_to_be() -> None:
    rng = np.random.default_rng(1)
    x, y, run = (a.ravel() for a in np.meshgrid(np.arange(6), np.arange(6), np.arange(4), indexing="ij"))
    off = 317e-6 * ((x == 2) & (y == 3))
    zero = np.zeros(len(x))
    columns = {"x": 0.05 * x, "y": 0.05 * y, "z": zero, "gz": 1.0, "displacement": off + 2e-6 * rng.normal(size=len(x))}
    found = diagnose(plates.session(columns, 2e-6, "none", ["EZX", "EZY"], run))
    assert len(found.gross_errors) == 4 and all(one.repeated for one in found.gross_errors)
    assert "diagnosis.outliers_repeat" in [k for words in verdict_words(found, {}, Advice()) for k in keys(words)]


def axis_both_ways(cycles: int, seed: int, drift: float = 0.0, half_width: float = 0.0) -> Session:
    """An axis there and back again without times: a drift, m over all, and a reversal; noise of 0.5 um."""
    rng, there = np.random.default_rng(seed), np.linspace(0.0, 0.8, 31)
    x = np.concatenate([np.concatenate([there, there[::-1]])] * cycles)
    at = np.arange(len(x))
    sense = np.where((at % 62) < 31, 1.0, -1.0)
    read = 8e-6 * np.sin(3.0 * x) + drift * at / len(x) - half_width * sense + 5e-7 * rng.normal(size=len(x))
    columns = {"x": x, "dir_x": sense, "displacement": read}
    return plates.session(columns, 5e-7, "none", ["EXX"], at // 62, repeats=cycles)


@pytest.mark.long(but=("4",))
@pytest.mark.parametrize("cycles", [2, 4])
def test_a_drift_without_times_is_no_reversal(cycles: int) -> None:
    """It goes with the order of all readings, which a reversal does not."""
    found = diagnose(axis_both_ways(cycles, 1, drift=10e-6))
    assert found.verdict == "unexplained" and not found.accepted
    assert found.search.structure[0].covariate == "order"
    found = diagnose(axis_both_ways(cycles, 1, half_width=2e-6))
    assert found.accepted == ("backlash_x",)


@pytest.mark.long
def test_there_and_back_once_without_times_a_drift_would_look_like_a_reversal() -> None:
    for cycles, told in ((1, True), (2, False)):
        found = diagnose(axis_both_ways(cycles, 2, half_width=2e-6))
        assert found.accepted == ("backlash_x",)
        said = [key for words in verdict_words(found, {}, Advice((), (), None)) for key in keys(words)]
        assert ("diagnosis.or_a_drift" in said) == told


def test_what_is_refused_for_having_no_size_is_not_likely() -> None:
    found = diagnose(axis_both_ways(2, 3, half_width=2e-6))
    name = found.accepted[0]
    unsure = replace(found, accepted=(), refused={name: say("undetermined.not_predicted", what="")})
    assert name in unsure.likely
    assert name not in replace(unsure, refused={name: say("undetermined.no_size")}).likely


def test_a_probable_effect_without_a_size_may_be_there_beside_those_found() -> None:
    """One that left-out readings speak against may not."""
    found = diagnose(axis_both_ways(2, 3, half_width=2e-6))
    name, share = found.accepted[0], found.search.of(found.accepted[0]).probability
    beside = replace(found, accepted=("linear_drift",), refused={name: say("undetermined.no_size_beside")})
    assert beside.alternatives[BESIDE] == {name: round(share, 2)}
    assert BESIDE not in replace(beside, refused={name: say("undetermined.not_predicted", what="")}).alternatives
    assert replace(beside, accepted=()).alternatives == beside.alternatives


def after_strokes(seed: int, moved: float) -> Session:
    """One place, after strokes of which long ones are followed by larger deviations of either sign, um, and a shift."""
    rng = np.random.default_rng(seed)
    stroke = rng.permutation(np.repeat([1.0, 3.0, 10.0, 30.0, 100.0, 300.0], 6))
    read = 1e-6 * (rng.normal(size=36) * (1.0 + stroke / 20.0) + moved * stroke)
    columns = {"time": 60.0 * np.arange(36), "x": 0.0, "stroke": stroke, "displacement": read}
    return plates.session(columns, 1e-6, "offset")


@pytest.mark.long
def test_scatter_that_grows_with_a_column_is_no_movement_with_it() -> None:
    every = [diagnose(after_strokes(seed, 0.0)) for seed in range(12)]
    assert not [name for found in every for name in found.accepted if name.startswith("follows")]
    reasons = [key for found in every for why in found.refused.values() for key in keys(why)]
    assert "undetermined.of_the_scatter" in reasons
    for seed in range(2):
        assert diagnose(after_strokes(seed, 0.1)).accepted


def test_an_effect_that_would_leave_no_reading_to_check_it_is_not_looked_for() -> None:
    """Ten places read once, of a curve: a polynomial through all of them proves nothing."""
    x = np.linspace(0.0, 0.9, 10)
    columns = {"x": x, "displacement": 3e-6 * np.exp(3.0 * x)}
    found = diagnose(plates.session(columns, 2e-7, "offset", ["EXX"]))
    assert not found.accepted and found.verdict != "missing_effect"
    spare = found.fits[0].solution.degrees_of_freedom
    for finding in found.search.findings:
        assert all(len(shaped.columns) < spare for shaped in finding.candidate.shapes)
    assert "too few readings" in found.excluded["EXX"]


def test_ten_readings_that_scatter_far_more_than_declared_have_no_cause() -> None:
    """Ten angles of a published calibration (an autocollimator, 1 arc second as 1 µm): a wave has F(3, 5) = 1.8."""
    table = [564.874, 564.220, 563.287, 562.509, 561.808, 561.068, 560.154, 559.319, 558.541, 557.713]
    at = np.array([49.42, 151.0, 251.64, 350.96, 451.82, 551.86, 650.85, 751.97, 855.49, 952.11])
    columns = {"time": 120.0 * np.arange(10.0), "x": 1e-3 * at, "displacement": -1e-6 * np.array(table)}
    found = diagnose(plates.session(columns, 2e-8, "offset", ("EXX",)))
    assert found.search.nothing > 0.5
    assert (found.verdict, found.accepted) == ("adequate", ())


@pytest.mark.long(but=("1023",))
@pytest.mark.parametrize("seed", [1021, 1023, 1025])
def test_noise_that_is_larger_than_declared_is_no_warm_up(seed: int) -> None:
    """One place read ten times: a warm-up had 0.94 to 1.00, as twenty readings had seemed to say what the noise is."""
    noise = 7.4e-6 * np.random.default_rng(seed).normal(size=10)
    columns = {"time": 600.0 * np.arange(10.0), "x": np.zeros(10), "gx": np.ones(10), "gy": np.zeros(10)}
    columns |= {"gz": np.zeros(10), "displacement": noise}
    found = diagnose(plates.session(columns, 1e-6, "none", ("EXX",), np.arange(10)))
    assert (found.verdict, found.accepted) == ("adequate", ())


def test_places_that_differ_from_setup_to_setup_are_no_matter_of_the_place() -> None:
    """Five places, whose heights are in the table, under nine loads, a setup and three readings each."""
    rng = np.random.default_rng(4)
    at, setup = np.tile(np.repeat(np.linspace(0.0, 0.4, 5), 3), 9), np.repeat(np.arange(9), 15)
    bent = 3e-5 * rng.normal(size=(9, 5))
    read = bent[setup, np.tile(np.repeat(np.arange(5), 3), 9)] + 1e-6 * rng.normal(size=135)
    columns = {"x": at, "gz": 1.0, "displacement": read}
    names = [f"L{k}" for k in range(9)]
    found = diagnose(plates.session(columns, 1e-6, "none", ("EZX",), None, *names, setup=setup.tolist()))
    told = [key for words in verdict_words(found, {}, Advice()) for key in keys(words)]
    assert "diagnosis.places_alike" not in told and "diagnosis.places_differ" not in told
    assert "diagnosis.structure_unsure" not in told
    assert any("shape.setups_differ" in keys(structure.shape) for structure in found.left)


def test_of_several_sessions_it_is_told_how_far_each_scatters() -> None:
    def level(scatter: float, seed: int) -> Session:
        at, rng = np.tile(np.linspace(0.0, 0.4, 9), 6), np.random.default_rng(seed)
        columns = {"x": at, "displacement": scatter * rng.normal(size=54)}
        return plates.session(columns, 1e-6, "none", ("EXX",), np.repeat(np.arange(6), 9))

    found = diagnose(FitRequest((level(1e-6, 1), level(3e-6, 2)), labels=("one", "other")))
    (told,) = [str(words) for words in verdict_words(found, {}, Advice()) if "diagnosis.scatter_of_each" in keys(words)]
    each = dict(re.findall(r"(one|other) ([\d.]+) times", told))
    assert float(each["one"]) == pytest.approx(1.0, abs=0.25)
    assert float(each["other"]) == pytest.approx(3.0, abs=0.7)


def test_of_a_session_that_the_model_leaves_no_reading_no_scatter_is_told() -> None:
    at, _zero = np.tile(np.linspace(0.0, 0.4, 9), 6), np.zeros(54)
    read = 5e-6 * np.random.default_rng(3).normal(size=54)
    columns = {"x": at, "displacement": read}
    one = plates.session(columns, 1e-6, "none", ("EXX",), np.repeat(np.arange(6), 9))
    single = {name: values[:1] for name, values in columns.items()}
    alone = plates.session({**single, "x": np.array([9.0])}, 1e-6, "offset", ("EXX",))
    found = diagnose(FitRequest((one, alone), labels=("one", "other")))
    (told,) = [str(words) for words in verdict_words(found, {}, Advice()) if "diagnosis.scatter_of_each" in keys(words)]
    assert "other – times" in told


@pytest.mark.parametrize("recorded", [False, True])
def test_what_goes_with_the_time_may_go_with_a_temperature_that_was_not_recorded(recorded: bool) -> None:
    session = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=3)).session
    readings = session.readings
    grown = 4e-6 * (1.0 - np.exp(-readings.columns["time"] / 900.0)) * readings.columns["x"] / 0.5
    columns = {k: v for k, v in readings.columns.items() if recorded or not k.startswith("temperature")}
    changed = replace(readings, displacement=readings.displacement + grown, columns=columns)
    found = diagnose(session.with_readings(changed))
    assert recorded or any(found.search.of(name).candidate.takes_time for name in found.accepted)
    told = [str(words) for words in verdict_words(found, {}, Advice()) if "diagnosis.unrecorded" in keys(words)]
    assert [("temperature_x" in words) for words in told] == ([] if recorded else [True])


@pytest.mark.parametrize("tau", [600.0, 1500.0])
def test_a_screw_that_is_slower_than_the_session_has_its_size_and_its_name(tau: float) -> None:
    """Nine minutes of it: the time constant had ended with them, and thermal expansion stood for it, too large."""
    grown = FlawSpec(id="screw_growth_x", size=8e-5, parameters={"tau": tau})
    plan = PRESETS["iso230_2"].model_copy(update={"repeats": 5})
    spec = SimulationSpec(plan=plan, machine=MachineSpec(seed=1), effects=(grown,), environment_swing=0.5, seed=4)
    session = simulate(spec).session
    sizes = {p.name: p for p in identify(session, effects=("screw_growth_x",)).parameters}
    for name, true in (("s", 8e-5), ("tau", tau)):
        found = sizes[f"screw_growth_x.{name}"]
        assert abs(found.value - true) < 2.0 * found.standard_uncertainty < true
    assert diagnose(session).accepted == ("screw_growth_x",)


@pytest.mark.parametrize("named", [False, True])
def test_an_axis_that_the_model_has_as_a_rigid_body_is_none_that_yields(named: bool) -> None:
    """A plate that is off along X by x y: yaw of X without a lever arm, or what no rigid body does."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(0.0, 0.4, 9), np.linspace(0.0, 0.3, 7)))
    x, y, along_x = np.tile(x, 4), np.tile(y, 4), np.repeat([1.0, 1.0, 0.0, 0.0], x.size)
    noise = 0.3e-6 * np.random.default_rng(5).standard_normal(x.size)
    columns = {"x": x, "y": y, "z": 0.0, "gx": along_x, "gy": 1.0 - along_x}
    columns["displacement"] = 8e-5 * x * y * along_x + noise
    terms = ("EXX", "EYX", "EXY", "EYY", "C0Y", *(["ECX"] if named else []))
    found = diagnose(plates.session(columns, 0.3e-6, "offset", terms))
    assert (found.verdict, found.accepted) == (("unexplained", ()) if named else ("missing_effect", ("ECX",)))
    assert not named or found.left[0].covariate == "x and y"
