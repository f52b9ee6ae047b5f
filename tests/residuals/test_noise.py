# SPDX-License-Identifier: Apache-2.0
"""Noise from repeats: of readings that repeat each other, and of no others.
What many readings in a row share is no gross error; what stands out of it is one.
"""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import Fit, fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.model.rounding import rounding_of
from machine_tool_calibration.residuals.averaged import mean_places, own_of_places
from machine_tool_calibration.residuals.gross_errors import Outlier, find_outliers, suspected_rows
from machine_tool_calibration.residuals.noise import noise_of, pooled
from machine_tool_calibration.residuals.places import _beside, _moran, alike_beside_p
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

from .. import plates


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


@pytest.mark.parametrize(("holes", "lost", "count"), [(2, 1, 0), (2, 0, 4), (50, 0, 100), (50, 1, 99), (51, 0, 0)])
def test_holes_have_constants_of_their_own_where_neither_few_nor_many_were_read_again(
    holes: int, lost: int, count: int
) -> None:
    """x and y of each are places; of what was lost in the second run nothing was read again."""
    session = plates.plate(1, holes=holes, repeats=2)[0]
    kept = session.with_readings(session.readings.select(np.arange(4 * holes - lost)))
    fit: Any = SimpleNamespace(model=build_model(kept)[0])
    families = own_of_places(fit)
    assert [family.name for family in families] == ["place"] * (count > 0)
    for family in families:
        assert len(np.unique(family.group[family.shapes[0] > 0])) == count


@pytest.mark.long
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


def test_places_in_any_order_are_alike_by_chance_alone() -> None:
    """Moran's I in standard deviations: zero and one over all orders of the same values (as of a normal sample)."""
    rng = np.random.default_rng(3)
    where = np.stack(np.meshgrid(np.arange(8.0), np.arange(6.0), [0.0]), axis=-1).reshape(-1, 3)
    pairs, values = _beside(where, np.zeros(48, dtype=int), 4), rng.normal(size=48)
    values -= values.mean()
    found = [_moran(rng.permutation(values), pairs) for _ in range(1000)]
    assert np.mean(found) == pytest.approx(0.0, abs=0.1)
    assert np.std(found) == pytest.approx(1.0, abs=0.1)
    assert _moran(np.sort(values), pairs) > 5.0


def test_what_another_session_misses_is_no_noise_of_this_one_and_their_order_tells_nothing() -> None:
    """One machine in two sessions, of which the second saw it warm up."""

    def model(seed: int, *effects: FlawSpec) -> MethodModel:
        spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=seed, effects=effects)
        return build_model(simulate(spec).session)[0]

    sound, warm = model(3), model(3, FlawSpec(id="warmup_x", size=30e-6))
    alone = noise_of(fit_models([sound]).fits[0])
    both = fit_models([sound, warm], ("sound", "warm"))
    beside = [noise_of(fit) for fit in both.fits]
    assert alone.from_repeats is not None and both.reduced_chi_square > 4.0
    assert beside[0].from_repeats == pytest.approx(alone.from_repeats, rel=0.2)
    there, back = pooled(beside, 0.5), pooled(beside[::-1], 0.5)
    assert there.from_repeats is not None and there.from_repeats == pytest.approx(back.from_repeats)
    assert (there.repeats, there.as_read, there.chi_square_p) == (beside[0].repeats + beside[1].repeats, None, 0.5)
    assert min(one.from_repeats or 0.0 for one in beside) < there.from_repeats


@pytest.mark.parametrize("unit", [0.1, 1.0, 2.0, 5.0, 10.0, 100.0])
def test_where_the_model_holds_every_place_repeats_say_no_more_than_it(unit: float) -> None:
    read = unit * 1e-5 * np.random.default_rng(8).normal(size=26)
    setup = np.repeat([0, 1, 2], [9, 9, 8])
    columns = {"x": 0 * read, "displacement": read}
    one = plates.session(columns, unit * 1e-5, "offset", ("EXX",), None, "A", "B", "C", setup=setup)
    assert noise_of(fit_models([build_model(one)[0]]).fits[0]).lack_of_fit_p is None


def test_readings_that_are_rounded_scatter_by_the_digit_at_least() -> None:
    assert rounding_of(np.array([0.185, 0.184, 0.185, np.nan])) == pytest.approx(0.001 / np.sqrt(12.0))
    assert rounding_of(0.1 + 1e-7 * np.array([0.0, 20.0, 35.0, 50.0])) == pytest.approx(5e-7 / np.sqrt(12.0), rel=1e-6)
    assert rounding_of(np.full(5, 0.185)) == rounding_of(np.zeros(0)) == 0.0
    assert rounding_of(np.random.default_rng(1).normal(size=9)) == 0.0  # a few values far apart


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


NOISE = 1.5e-7
HEAD = """format: mtcal-session/1
method: direct
machine: {chain: w-X-b-t, travel: {x: [0.0, 0.5]}}
repeats: 1
standard_uncertainty: {displacement: 1.5e-07}
datum: offset
terms: [EXX]
setups:
- {id: A}
"""


def found_in(session: Session) -> list[Outlier]:
    """What is set aside by the method's own model."""
    return find_outliers(session, lambda part: build_model(part)[0])


def warming(folder: Path, constants: tuple[float, float], size: float, gross: dict[int, float]) -> Session:
    """One place read 570 times in three hours while the frame warms up; then five others."""
    rng = np.random.default_rng(4)
    time = 19.0 * np.arange(575)
    course = size * (0.6 * np.exp(-time / constants[0]) + 0.4 * np.exp(-time / constants[1]))
    displacement = np.where(np.arange(575) < 570, course, 0.0) + NOISE * rng.standard_normal(575)
    displacement[list(gross)] += NOISE * np.array(list(gross.values()))
    x = 0.1 + 0.05 * np.maximum(np.arange(575) - 569, 0)
    rows = zip(time, x, displacement, strict=True)
    lines = ["time,setup,repeat,x,dir_x,gx,gy,gz,displacement"]
    lines += [f"{t:.1f},A,0,{place:.3f},1,1,0,0,{value:.12g}" for t, place, value in rows]
    (folder / "session.yaml").write_text(HEAD, encoding="utf-8")
    (folder / "observations.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return read_session(folder)


@pytest.mark.parametrize("size", [116e-6, 15e-6, 3e-6])
@pytest.mark.parametrize("constants", [(70.0, 600.0), (300.0, 3600.0), (1200.0, 1500.0)])
def test_a_transient_loses_no_reading(tmp_path: Path, size: float, constants: tuple[float, float]) -> None:
    assert found_in(warming(tmp_path, constants, size, {})) == []


def test_gross_errors_within_a_transient_are_found(tmp_path: Path) -> None:
    errors = {60: 40.0, 150: -20.0, 151: 30.0, 400: -15.0}
    found = found_in(warming(tmp_path, (300.0, 3600.0), 15e-6, errors))
    assert {o.row for o in found} == set(errors)


def test_an_answer_does_not_depend_on_what_was_asked_before() -> None:
    spec = SimulationSpec(plan=PRESETS["tracking_2d"], seed=3, effects=(FlawSpec(id="backlash_y", size=1e-6),))
    session = simulate(spec).session

    def build(part: Session) -> MethodModel:
        return build_model(part)[0]

    first = find_outliers(session, build)
    suspected_rows(session, build)
    assert find_outliers(session, build) == first


def test_a_place_that_is_lost_is_said() -> None:
    """Of a place that was read twice, with few others beside it, nothing tells which reading is right."""
    plan = PRESETS["straightness"].model_copy(update={"repeats": 2, "count": 7})
    session = simulate(SimulationSpec(plan=plan, seed=5)).session
    readings = session.readings
    displacement = readings.displacement.copy()
    displacement[3] += 3e-4
    wrong = session.with_readings(replace(readings, displacement=displacement))
    found = identify(wrong)
    rejected = found.rejected
    assert {r.row for r in rejected} == set(np.flatnonzero(readings.columns["x"] == readings.columns["x"][3]).tolist())
    for words in ("two readings of one place differ by", "no other reading of its place is left"):
        assert all(words in r.reason for r in rejected)
    where = f"({1e3 * readings.columns['x'][3]:g}, 0, 0) mm"
    assert [(n.name, n.why) for n in found.not_determined if where in n.name] == [
        (f"deviation along (0, 1, 0) at {where}", "no reading of it is left")
    ]
    assert identify(session).not_determined == identify(wrong, keep_all=True).not_determined


@pytest.mark.parametrize("from_where", ["the same", "the other side", "everywhere"])
def test_a_place_that_other_setups_read_is_not_lost(from_where: str) -> None:
    """A straightness measured once in each of several mountings; all but one of them may read it from elsewhere."""
    plan = PRESETS["straightness"].model_copy(update={"repeats": 8})
    session = simulate(SimulationSpec(plan=plan, seed=5)).session
    readings, names = session.readings, [f"m{k}" for k in range(8)]
    setups = tuple(session.description.setups[0].model_copy(update={"id": name}) for name in names)
    displacement = readings.displacement.copy()
    displacement[4] += 3e-4
    side = np.where((from_where == "the other side") & (readings.repeat > 0), -1.0, 1.0)
    oblique = 0.02 * np.arange(len(side)) / len(side) * (from_where == "everywhere")
    sensed = {"gy": side * readings.columns["gy"], "gz": readings.columns["gz"] + oblique}
    readings = replace(readings, columns={**readings.columns, **sensed})
    displacement *= side
    mounted = replace(
        session,
        description=session.description.model_copy(update={"setups": setups, "repeats": 1, "datum": "offset"}),
        readings=replace(readings, setup=readings.repeat, repeat=0 * readings.repeat, displacement=displacement),
    )
    found = identify(mounted)
    rejected = found.rejected
    assert [r.row for r in rejected] == [4]
    assert "no other reading of its place" not in rejected[0].reason
    assert not any("no reading of it is left" in one.why for one in found.not_determined)


def test_a_run_on_another_zero_loses_no_reading(tmp_path: Path) -> None:
    """Most of its places nothing else read: there it agrees with itself, which is no sign that the others are wrong."""
    rng = np.random.default_rng(6)
    repeated = [(place, k) for place in (0.1, 0.25, 0.4) for k in range(1, 6)]
    run = [(place, 0) for place in np.linspace(0.0, 0.5, 11)]
    lines = ["setup,repeat,x,dir_x,gx,gy,gz,displacement"]
    for place, k in repeated + run + run[::-1]:
        value = (30e-6 if k == 0 else 0.0) + NOISE * rng.standard_normal()
        lines.append(f"A,{k},{place:.3f},1,1,0,0,{value:.12g}")
    (tmp_path / "session.yaml").write_text(HEAD.replace("repeats: 1", "repeats: 6"), encoding="utf-8")
    (tmp_path / "observations.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    session = read_session(tmp_path)
    assert found_in(session) == []
    assert max(spread["size"] for spread in identify(session).document()["spread"]) > 5e-6


@pytest.mark.long
@pytest.mark.parametrize("after", [26, 28, 30])
def test_a_step_within_a_run_loses_no_reading(after: int) -> None:
    """The model takes up most of it, so that five or ten readings before and after it stand out together."""
    session = simulate(SimulationSpec(plan=PRESETS["rotary_axis"], seed=3)).session
    readings = session.readings
    later = np.flatnonzero((readings.setup == 2) & (readings.repeat == 0))[after:]
    displacement = readings.displacement.copy()
    displacement[later] += 17.0 * session.sigma
    assert found_in(session.with_readings(replace(readings, displacement=displacement))) == []


@pytest.mark.long
def test_what_reproduces_is_no_gross_error() -> None:
    """Both readings of one place are off by as much."""
    session = simulate(SimulationSpec(plan=PRESETS["step_diagonal"], seed=3)).session
    readings = session.readings
    displacement = readings.displacement.copy()
    displacement[[60, 217]] += 17.0 * session.sigma
    assert [readings.columns[axis][60] for axis in "xyz"] == [readings.columns[axis][217] for axis in "xyz"]
    assert found_in(session.with_readings(replace(readings, displacement=displacement))) == []
    displacement[217] -= 17.0 * session.sigma
    alone = found_in(session.with_readings(replace(readings, displacement=displacement)))
    assert [outlier.row for outlier in alone] == [60]


@pytest.mark.parametrize("off", [0.0, 4e-6])
def test_repeats_of_sessions_that_contradict_each_other_scatter_as_they_do(off: float) -> None:
    base = plates.axis(3, noise=0.0, declared=1e-6, wander=8e-6, terms=("EXX",))
    own = [
        base.readings.displacement + 1e-6 * np.random.default_rng(seed).normal(size=len(base.readings))
        for seed in (1, 2)
    ]
    own[1] = own[1] + off * np.sin(12.0 * base.readings.columns["x"])
    two = tuple(plates.with_columns(base, values) for values in own)
    together = fit_sessions(FitRequest(two, ("a", "b"))).joint
    for session, fit in zip(two, together.fits, strict=True):
        alone = noise_of(fit_sessions(FitRequest((session,))).joint.fits[0])
        assert noise_of(fit).from_repeats == pytest.approx(alone.from_repeats, rel=0.1)
