# SPDX-License-Identifier: Apache-2.0
"""Circles with a ball bar: against exact geometry, which knows nothing of the model."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.budget.complete import completed
from machine_tool_calibration.budget.conformity import Verdict, conformity
from machine_tool_calibration.budget.propagate import propagate
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.errors import ModelError, SessionError
from machine_tool_calibration.importing.build import Imported, import_table
from machine_tool_calibration.importing.mapping import parse_mapping
from machine_tool_calibration.methods.ball_bar.circle import way_over_time
from machine_tool_calibration.methods.ball_bar.iso230_4 import _mean_path
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.fitted import fit_sessions
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.planning.forecast import Assumed, forecast
from machine_tool_calibration.procedure.description import read_procedure
from machine_tool_calibration.procedure.steps import plan
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.contributor import Contributor
from machine_tool_calibration.session.description import BallBar, Place
from machine_tool_calibration.session.parse import describe
from machine_tool_calibration.session.session import Session, assemble
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate
from machine_tool_calibration.simulation.spec import FlawSpec
from machine_tool_calibration.trends.statement import sizes_of

from ..plates import with_columns

ROOT = Path(__file__).parents[2]
RADIUS, SIGMA, FEED, REACH = 0.15, 2e-7, 0.02, 0.01
CENTRE = np.array([0.25, 0.2, 0.3])
PLANES = {"XY": (0, 1), "YZ": (1, 2), "ZX": (2, 0)}


class Circles:
    """Places around circles in planes, counter-clockwise and clockwise, with the way of the tool there."""

    def __init__(self, *planes: str, count: int = 48) -> None:
        turn = (np.arange(count) + 0.3) * 2.0 * np.pi / count
        self.planes = planes
        self.setup = np.repeat(planes, 2 * count)
        self.sense = np.tile(np.repeat([1.0, -1.0], count), len(planes))
        self.angle = np.tile(np.concatenate([turn, -turn]), len(planes))
        self.arm, self.way = np.zeros((2, len(self.angle), 3))
        for k, (name, angle, sense) in enumerate(zip(self.setup, self.angle, self.sense, strict=True)):
            self.arm[k, PLANES[name]] = RADIUS * np.array([np.cos(angle), np.sin(angle)])
            self.way[k, PLANES[name]] = sense * np.array([-np.sin(angle), np.cos(angle)])
        self.moved = np.where(self.way < 0.0, -1.0, 1.0)

    def length(self, error: Array) -> Array:
        """(n,) exact change of the distance to the centre by displacements (n, 3), m."""
        return np.asarray(np.linalg.norm(self.arm + error, axis=1) - RADIUS)

    def session(self, displacement: Array | float = 0.0, **more: Any) -> Session:
        """What was read."""
        own = {"centre": CENTRE.tolist(), "radius": RADIUS, "feed": FEED}
        content = {
            "format": "mtcal-session/1",
            "method": "ball_bar",
            "machine": {"chain": "w-Y-X-b-Z-t"},
            "standard_uncertainty": {"displacement": SIGMA},
            "setups": [{"id": name, "plane": name} | own for name in self.planes],
        } | more
        numbers = {"displacement": np.zeros(len(self.angle)) + displacement, "repeat": np.zeros(len(self.angle))}
        for j, axis in enumerate("xyz"):
            numbers |= {axis: CENTRE[j] + self.arm[:, j], f"dir_{axis}": self.moved[:, j]}
        place = Place("session.yaml", "observations.csv")
        description = describe(content, "session.yaml")
        session = Session(description, assemble(description, numbers, {"setup": self.setup}, place), "test")
        check_session(session, place)
        return session


def since_reversal(circles: Circles, axis: int) -> Array:
    """(n,) path along the circle since the axis turned, found by going back in small steps, m."""
    out = np.full(len(circles.angle), np.inf)
    steps = np.arange(0.0, np.pi, 1e-4)
    for k in np.flatnonzero(circles.way[:, axis] != 0.0):
        back = np.cos(steps) * circles.way[k, axis] + np.sin(steps) * circles.arm[k, axis] / RADIUS
        out[k] = RADIUS * steps[int(np.argmax(back * circles.way[k, axis] < 0.0))]
    return out


@pytest.mark.parametrize("name", ["servo_mismatch_y", "reversal_spike_z"])
def test_an_effect_of_the_path_is_what_it_moves_in_exact_geometry(name: str) -> None:
    circles, size = Circles("XY", "YZ", "ZX"), 1e-7
    late = -FEED * circles.way * (0.0, 1.0, 0.0)
    held_back = np.zeros_like(circles.moved)  # against the way that the axis goes
    held_back[:, 2] = -circles.moved[:, 2] * np.exp(-since_reversal(circles, 2) / REACH)
    (effect,) = find_effects([name])
    columns = effect.columns(build_model(circles.session())[0].observations, (REACH,) * len(effect.shapes))
    exact = circles.length(size * (late if effect.id.startswith("servo") else held_back)) / size
    np.testing.assert_allclose(columns, exact[None], atol=3e-3 * np.abs(exact).max())


def found(result: Result) -> dict[str, tuple[float, float]]:
    return {p.name: (p.value, p.standard_uncertainty) for p in result.parameters}


@pytest.mark.parametrize("planes", [("XY",), ("YZ",), ("ZX",), ("XY", "YZ", "ZX")])
def test_centre_length_squareness_and_scales_are_found(planes: tuple[str, ...]) -> None:
    circles, rng = Circles(*planes), np.random.default_rng(5)
    place = CENTRE + circles.arm
    scale, square = np.array([3e-6, -5e-6, 9e-6]), {"C0Y": 12e-6, "A0Z": -7e-6, "B0Z": 5e-6}
    error = scale * place
    error[:, 0] -= square["C0Y"] * place[:, 1]  # ISO 230-1: Y turned about Z, Z about X and Y
    error[:, 1] -= square["A0Z"] * place[:, 2]
    error[:, 0] += square["B0Z"] * place[:, 2]
    offset = np.array([80e-6, -120e-6, 50e-6])
    reading = np.linalg.norm(circles.arm + error - offset, axis=1) - RADIUS - 4e-6
    result = identify(circles.session(reading + SIGMA * rng.normal(size=len(reading))))
    values = found(result)
    axes = sorted({axis for name in planes for axis in name})
    for axis in axes[1:]:
        value, u = values[f"scale_{axis.lower()}_less_{axes[0].lower()}"]
        assert abs(value - scale["XYZ".index(axis)] + scale["XYZ".index(axes[0])]) < 4.0 * u < 3e-6
    for name, key in (("C0Y", "XY"), ("A0Z", "YZ"), ("B0Z", "ZX")):
        assert (name in values) == (key in planes)
        if key in planes:
            assert abs(values[name][0] - square[name]) < 4.0 * values[name][1] < 3e-6
    assert result.fit.joint.reduced_chi_square < 1.4
    assert [entry.name for entry in result.not_determined] == ["mean_scale"]
    meanings = {p.name: str(p.meaning) for p in result.fit.model.parameters}
    assert meanings[f"scale_{axes[1].lower()}_less_{axes[0].lower()}"] == f"scale of {axes[1]} less that of {axes[0]}"


def test_figures_are_those_of_iso_230_4() -> None:
    circles = Circles("XY", count=360)
    # An ellipse at 45 degrees of 3 um either way, and 1 um between the ways round, about a centre that is off.
    ellipse, between = 3e-6 * np.sin(2.0 * circles.angle), 0.5e-6 * circles.sense
    reading = 20e-6 * np.cos(circles.angle) + 7e-6 + ellipse + between
    session = circles.session(reading, length_uncertainty=5e-7)
    content = identify(session, keep_all=True).error_map.content
    value = {one["name"]: one["value"] for one in content["figures"]}
    assert value["G_ccw"] == pytest.approx(6e-6, rel=1e-3)
    assert value["G_cw"] == pytest.approx(6e-6, rel=1e-3)
    assert value["G_b"] == pytest.approx(7e-6, rel=1e-3)
    assert value["H"] == pytest.approx(1e-6, rel=0.02)
    assert value["D"] == pytest.approx(7e-6, rel=1e-3)
    assert value["F_max_ccw"] == pytest.approx(10.5e-6, rel=1e-3)
    assert value["F_min_cw"] == pytest.approx(3.5e-6, rel=1e-3)
    assert value["G_b of C0Y"] == pytest.approx(6e-6, rel=1e-3)
    expanded = {one["name"]: one["U"] for one in content["figures"]}
    assert expanded["D"] == pytest.approx(1e-6, rel=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("ellipse", [0.0, 3e-6])
def test_u_of_a_range_counts_that_noise_makes_it_larger(ellipse: float) -> None:
    circles, rng, within = Circles("XY", count=360), np.random.default_rng(3), dict.fromkeys(("G_ccw", "G_b", "H"), 0)
    for _ in range(20):
        reading = ellipse * np.sin(2.0 * circles.angle) + SIGMA * rng.normal(size=len(circles.angle))
        for one in identify(circles.session(reading), keep_all=True).error_map.content["figures"]:
            if one["name"] in within:
                true = 0.0 if one["name"] == "H" else 2.0 * ellipse
                within[one["name"]] += abs(one["value"] - true) <= one["U"]
    assert min(within.values()) >= 17


def test_of_several_turns_the_path_is_the_mean_at_each_angle() -> None:
    angle = np.array([1.0, 2.0, 3.0])
    path = _mean_path(np.concatenate([angle + 2.0 * np.pi, angle]), np.array([1.0, 2, 3, 5, 4, 3]), np.full(6, 0.5))
    assert path.angle == pytest.approx(angle)
    assert path.radial.tolist() == [3.0, 3.0, 3.0]
    assert path.u == pytest.approx(np.full(3, 0.5 / np.sqrt(2.0)))


def test_a_cause_has_no_figure_in_a_plane_in_which_it_does_not_act() -> None:
    circles = Circles("XY", "YZ")
    square = np.zeros((len(circles.angle), 3))
    square[:, 0] = -1e-5 * (CENTRE + circles.arm)[:, 1]
    figures = identify(circles.session(circles.length(square))).error_map.content["figures"]
    (of_c0y,) = (one for one in figures if one["name"] == "G_b of C0Y")
    ellipse = 0.5e-5 * RADIUS * np.ptp(np.sin(2.0 * circles.angle[circles.setup == "XY"]))
    assert (of_c0y["setup"], of_c0y["value"]) == ("XY", pytest.approx(ellipse, rel=1e-3))


def simulated(*effects: str, seed: int = 1) -> Session:
    flaws = tuple(FlawSpec(id=name, amplitude=3e-6) for name in effects)
    return simulate(SimulationSpec(plan=PRESETS["ball_bar"], seed=seed, effects=flaws)).session


@pytest.mark.long
def test_nothing_is_missing_in_a_sound_machine() -> None:
    assert diagnose(simulated()).verdict == "adequate"


@pytest.mark.long
def test_three_causes_are_named_together() -> None:
    causes = ("backlash_y", "reversal_spike_x", "pitch_periodic_x")
    assert set(causes) <= set(diagnose(simulated(*causes)).accepted)


@pytest.mark.long
def test_a_straightness_that_is_periodic_is_no_vibration() -> None:
    flaw = FlawSpec(id="straightness_periodic_EXY", size=0.5e-6, parameters={"lead": 0.033})
    session = simulate(SimulationSpec(plan=PRESETS["ball_bar"], seed=1, effects=(flaw,))).session
    assert diagnose(session).accepted == ("straightness_periodic_EXY",)


def test_an_angle_of_one_lever_arm_is_the_straightness_there() -> None:
    def reasons(session: Session) -> dict[str, str | None]:
        seen = build_model(session)[0].observations
        return {name: find_effects([name])[0].why_not(seen) for name in ("EAX", "EBY", "ECX", "EYX", "reversal_EAX")}

    low = Circles("XY").session()
    assert reasons(low) == {
        "EAX": "with one lever arm it is EYX",
        "EBY": "with one lever arm it is EXY",
        "ECX": None,
        "EYX": None,
        "reversal_EAX": "with one lever arm it is EYX",
    }
    # A second circle at another height has another lever arm.
    heights = np.where(np.arange(len(low.readings)) % 2, 0.0, 0.1)
    assert reasons(with_columns(low, z=low.readings.columns["z"] + heights))["EAX"] is None


@pytest.mark.long
def test_of_a_servo_mismatch_one_plane_does_not_tell_which_axis_is_late() -> None:
    accepted = diagnose(simulated("servo_mismatch_y")).accepted
    assert len({"servo_mismatch_x", "servo_mismatch_y"} & set(accepted)) == 1


@pytest.mark.long
@pytest.mark.parametrize("repeats", [1, 2])
def test_a_vibration_is_told_from_a_wave_of_the_screw(repeats: int) -> None:
    size, frequency = 0.4e-6, 0.37
    plan = PRESETS["ball_bar"].model_copy(update={"repeats": repeats})
    flaws = (FlawSpec(id="vibration_y", size=size, parameters={"frequency": frequency}),)
    session = simulate(SimulationSpec(plan=plan, seed=3, effects=flaws)).session
    assert diagnose(session).accepted == ("vibration_y",)
    values = found(identify(session, effects=["vibration_y"]))
    value, u = values["vibration_y.frequency"]
    assert abs(value - frequency) < 4.0 * u < 1e-3
    # Every circle has an amplitude of its own, which is the same here.
    for run in range(1, 4 * repeats + 1):
        (s, u_s), (c, u_c) = (values[f"vibration_y.{part}{run}"] for part in "sc")
        assert abs(np.hypot(s, c) - size) < 4.0 * max(u_s, u_c) < 2e-7


@pytest.mark.long
def test_a_run_of_one_reading_has_no_frequencies() -> None:
    plan = PRESETS["ball_bar"]
    session = simulate(SimulationSpec(plan=plan, seed=3, effects=(FlawSpec(id="backlash_x", amplitude=3e-6),))).session
    kept = np.ones(len(session.readings), dtype=bool)
    kept[1:6] = False  # a beam that was interrupted leaves the first reading alone
    assert diagnose(session.with_readings(session.readings.select(kept))).accepted == ("backlash_x",)


@pytest.mark.long
@pytest.mark.parametrize("hidden", [(), ("backlash_x",)])
def test_readings_that_a_filter_has_smoothed_have_no_other_cause(hidden: tuple[str, ...]) -> None:
    flaws = tuple(FlawSpec(id=name, amplitude=3e-6) for name in hidden)
    session = simulate(SimulationSpec(plan=PRESETS["ball_bar"], seed=8, noise_factor=0.0, effects=flaws)).session
    noise = SIGMA * np.random.default_rng(8).normal(size=len(session.readings))
    smoothed = np.convolve(noise, np.ones(15) / np.sqrt(15.0), "same")
    found = diagnose(with_columns(session, session.readings.displacement + smoothed))
    assert found.accepted == hidden
    assert found.search.memory > 10.0


def test_without_times_no_vibration_is_looked_for() -> None:
    excluded = diagnose(Circles("XY", count=40).session()).excluded
    assert "time was not recorded" in excluded["vibration_x"]


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_a_wave_of_an_unusual_lead_is_found_in_a_circle(seed: int) -> None:
    """3.7 mm is none of the usual leads, and each reading of a circle senses the axis by a share of its own."""
    flaw = FlawSpec(id="pitch_periodic_x", size=1.2e-6, parameters={"lead": 3.7e-3})
    session = simulate(SimulationSpec(plan=PRESETS["ball_bar"], seed=seed, effects=(flaw,))).session
    assert diagnose(session).accepted == ("pitch_periodic_x",)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.session(RADIUS), "it looks like the length"),
        (lambda c: c.session(0.012), "it looks like millimetres"),
        (lambda c: c.session(setups=[{"id": "XY", "plane": "XY", "centre": [0.25, 0.21, 0.3], "radius": RADIUS}]),
         "the stated circle"),
        (lambda c: c.session(machine={"chain": "w-X-b-Z-t"}), "has no axis Y"),
        (lambda _: Circles("XY", count=3).session(), "no setup has more than 6; at least 8 are needed"),
    ],
)  # fmt: skip
def test_a_session_that_cannot_be_is_refused(change: Any, message: str) -> None:
    with pytest.raises(SessionError, match=message):
        change(Circles("XY"))


def test_directions_that_go_no_way_round_are_refused() -> None:
    circles = Circles("XY")
    circles.moved[:, 0] *= -1.0
    with pytest.raises(SessionError, match="one way round"):
        circles.session()


def table(folder: Path, lines: list[str], **columns: Any) -> Imported:
    file = folder / "circle.csv"
    file.write_text("\n".join(lines) + "\n")
    content = {
        "table": "circles",
        "columns": {
            "angle": {"column": "Angle", "unit": "deg"},
            "radius": {"column": "Radius", "unit": "mm"},
            **columns,
        },
        "session": {
            "machine": {"chain": "w-Y-X-b-Z-t"},
            "setups": [{"id": "XY", "plane": "XY", "centre": CENTRE.tolist(), "radius": RADIUS}],
            "standard_uncertainty": "0.2um",
        },
    }
    return import_table(file, parse_mapping(content, "mapping"))


def test_a_table_of_radii_over_the_angle_is_read(tmp_path: Path) -> None:
    forth = (np.arange(90) + 0.25) * 4.0 + 90.0
    lines = ["Angle,Radius"]
    # Twice round one way without a stop and once the other, across 360 degrees, with the scatter of a trigger.
    for k, angles in enumerate((forth, forth, forth[::-1])):
        lines += [f"{(a + 0.2 * (-1) ** j) % 360:.3f},{150.001 + 0.001 * k:.4f}" for j, a in enumerate(angles)]
    session = table(tmp_path, lines).session
    readings = session.readings
    np.testing.assert_array_equal(readings.repeat, 0)
    np.testing.assert_allclose(readings.displacement[[0, -1]], [1e-6, 3e-6], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(readings.position() - CENTRE, axis=1), RADIUS)
    # At the top, counter-clockwise, X goes down.
    assert readings.columns["dir_x"][0] == -1.0
    assert readings.columns["dir_x"][-1] == 1.0


def test_a_column_says_which_repeat_a_reading_is_of(tmp_path: Path) -> None:
    """Of two turns one way round, without a stop between them."""
    angle = 4.0 * np.arange(180) + 1.0
    rows = [f"{a % 360:.1f},150.001,{k // 90 + 1}" for k, a in enumerate(angle)]
    session = table(tmp_path, ["Angle,Radius,Turn", *rows], repeat="Turn").session
    np.testing.assert_array_equal(session.readings.repeat, np.arange(180) // 90)
    with pytest.raises(SessionError, match=r"circle.csv line 2: repeat is 0.5, not a whole number"):
        table(tmp_path, ["Angle,Radius,Turn", "1.0,150.001,0.5", *rows[1:]], repeat="Turn")


def test_at_a_reversal_an_axis_has_the_sense_of_the_way_there(tmp_path: Path) -> None:
    forth = 10 * np.arange(37)
    lines = ["Angle,Radius", *(f"{a % 360},150.0" for a in [*forth, *(forth + 1)[::-1][1:], 0])]
    session = table(tmp_path, lines).session
    columns, at = session.readings.columns, session.readings.position() - CENTRE
    for axis, k in (("x", 0), ("y", 1)):
        moved = np.diff(at[:, k])
        for way in (slice(0, 36), slice(38, 73)):  # not where the way round changes
            assert np.array_equal(columns[f"dir_{axis}"][1:][way], np.sign(moved)[way])


def test_tables_of_several_planes_are_one_session(tmp_path: Path) -> None:
    files = [tmp_path / f"{plane}.csv" for plane in ("XY", "YZ")]
    for file in files:
        file.write_text("\n".join(["Angle,Deviation", *(f"{4 * k + 1},0.5" for k in range(90))]) + "\n")
    own = {"centre": CENTRE.tolist(), "radius": RADIUS}
    content = {
        "table": "circles",
        "columns": {"angle": {"column": "Angle", "unit": "deg"}, "deviation": {"column": "Deviation", "unit": "um"}},
        "session": {
            "machine": {"chain": "w-Y-X-b-Z-t"},
            "setups": [{"id": file.stem, "plane": file.stem} | own for file in files],
            "standard_uncertainty": "0.2um",
        },
    }
    session = import_table(files, parse_mapping(content, "mapping")).session
    assert session.setup_ids == ("XY", "YZ")
    of_yz = session.readings.position()[session.readings.setup == 1] - CENTRE
    np.testing.assert_allclose(np.abs(of_yz[:, 0]), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(of_yz, axis=1), RADIUS)
    content["session"]["setups"] = content["session"]["setups"][:1] * 2
    with pytest.raises(SessionError, match="must say which circle"):
        import_table(files, parse_mapping(content, "mapping"))


def test_angles_in_disorder_are_refused(tmp_path: Path) -> None:
    angle = np.random.default_rng(1).permutation(90) * 4.0
    with pytest.raises(SessionError, match="neither one way round nor first one and then the other"):
        table(tmp_path, ["Angle,Radius", *(f"{a},150.0" for a in angle)])


def test_a_procedure_is_planned_and_foretold() -> None:
    procedure = read_procedure(ROOT / "config" / "procedures" / "ball_bar.yaml")
    steps = plan(procedure, 1000).steps
    assert len(steps) == 288
    place = np.array([[step.position[axis] for axis in "xyz"] for step in steps])
    np.testing.assert_allclose(np.hypot(place[:, 0] - 0.21, place[:, 1] - 0.2), 0.15, atol=1e-9)
    way = np.array([[step.direction[axis] for axis in "xy"] for step in steps])
    np.testing.assert_array_equal(np.sign(np.diff(place[:72, :2], axis=0)), way[1:72])
    result = forecast(procedure, Assumed()).result
    assert found(result)["C0Y"][1] < 1e-6


def test_a_circle_beyond_the_travel_is_refused() -> None:
    procedure = read_procedure(ROOT / "config" / "procedures" / "ball_bar.yaml")
    machine = procedure.session.machine.model_copy(update={"travel": {"x": (0.1, 0.42), "y": (0.0, 0.4)}})
    session = procedure.session.model_copy(update={"machine": machine})
    with pytest.raises(SessionError, match=r"circle XY reaches x = 0\.0"):
        plan(procedure.model_copy(update={"session": session}), 1000)


def simulated_circles(seed: int, *flaws: FlawSpec, feeds: bool = True) -> Session:
    """Circles at two feeds in XY; without `feeds` the description does not say these."""
    session = simulate(SimulationSpec(plan=PRESETS["ball_bar"], seed=seed, effects=flaws)).session
    if feeds:
        return session
    setups = tuple(setup.model_copy(update={"feed": None}) for setup in session.description.as_a(BallBar).setups)
    return replace(session, description=session.description.model_copy(update={"setups": setups}))


@pytest.mark.long(but=("3e-06",))
@pytest.mark.parametrize("size", [3e-6, 12e-6])
def test_spikes_of_circles_that_were_read_on_the_move_are_no_gross_errors(size: float) -> None:
    """At another feed the readings are tens of micrometres beside those of the first."""
    spike = FlawSpec(id="reversal_spike_y", amplitude=size, parameters={"reach": 5e-3})
    session = simulated_circles(3, spike)
    readings, rng = session.readings, np.random.default_rng(3)
    beside = {name: readings.columns[name] + 3e-5 * rng.normal(size=len(readings)) for name in "xy"}
    moved = session.with_readings(replace(readings, columns={**readings.columns, **beside}))
    assert not identify(moved).rejected
    wrong = moved.readings.displacement + 2e-5 * (readings.row == 77)
    found = identify(moved.with_readings(replace(moved.readings, displacement=wrong)))
    assert [one.row for one in found.rejected] == [77]


def test_what_the_model_lacks_is_in_the_figures_and_no_noise_of_theirs() -> None:
    """A backlash makes the circles wider; their U is as without it."""

    def figures(*flaws: FlawSpec) -> tuple[Array, Array]:
        every = identify(simulated_circles(5, *flaws)).error_map.content["figures"]
        mine = [figure for figure in every if figure["name"] in ("G_ccw", "G_cw", "G_b", "H")]
        return np.array([one["value"] for one in mine]), np.array([one["U"] for one in mine])

    (without, u), (wide, own) = figures(), figures(FlawSpec(id="backlash_x", size=3e-6))
    assert (wide > without + 2e-6).all()
    assert np.median(own / u) == pytest.approx(1.0, abs=0.3)


def test_without_a_feed_way_over_time_says_it() -> None:
    stated, silent = (simulated_circles(2, feeds=feeds) for feeds in (True, False))
    own, made = (build_model(one)[0].observations.readings.columns["feed"] for one in (stated, silent))
    np.testing.assert_allclose(made, own, rtol=1e-2)
    (effect,) = find_effects(["servo_mismatch_x"])
    assert effect.why_not(build_model(silent)[0].observations) is None


def test_an_arc_is_said_to_be_one() -> None:
    circles = Circles("XY")
    session = circles.session()
    spec = spec_of(session)
    assert not list(spec.suspicious(session))
    arc = session.with_readings(session.readings.select(np.flatnonzero(circles.arm[:, 0] > 0.1)))
    (said,) = spec.suspicious(arc)
    assert said.startswith("setup 'XY' was read over 95° of its circle: G")


def test_a_feed_in_millimetres_a_minute_is_suspicious() -> None:
    session = simulated_circles(2)
    setups = session.description.as_a(BallBar).setups
    wrong = tuple(setup.model_copy(update={"feed": 6e4 * (setup.feed or 0.0)}) for setup in setups)
    off = replace(session, description=session.description.model_copy(update={"setups": wrong}))
    spec = spec_of(session)
    assert not list(spec.suspicious(session))
    assert len(list(spec.suspicious(off))) == len(setups)
    assert "way over time is" in next(iter(spec.suspicious(off)))


def test_where_the_tool_may_have_stopped_for_each_reading_no_feed_is_told() -> None:
    readings = simulated_circles(2).readings
    slow = {**readings.columns, "time": 1.5 * np.arange(len(readings))}
    assert np.isnan(way_over_time(replace(readings, columns=slow))).all()


def test_circles_that_repeat_what_no_effect_does_are_unexplained() -> None:
    """A form without any law, the same in both runs, is no noise with a memory."""
    circles = Circles("XY", count=240)
    form = np.cumsum(np.random.default_rng(5).normal(size=480)) / 8
    session = circles.session(circles.length(np.outer(2e-6 * (form - form.mean()), [0.0, 1.0, 0.0])))
    twice = session.readings.select(np.tile(np.arange(480), 2))
    noise = SIGMA * np.random.default_rng(2).normal(size=960)
    readings = replace(
        twice, repeat=np.repeat([0, 1], 480), row=np.arange(960), displacement=twice.displacement + noise
    )
    assert diagnose(session.with_readings(readings)).verdict == "unexplained"


def test_the_figures_have_tolerances_a_budget_and_a_trend() -> None:
    """An oval of the XY plane by its squareness, G = C R; with a bar whose length is known G, H and F, D differ."""
    circles, squareness, known = Circles("XY", "YZ"), 40e-6, 0.5e-6
    error = np.zeros((len(circles.angle), 3))
    error[:, 1] = np.where(circles.setup == "XY", squareness * circles.arm[:, 0], 0.0)
    noise = SIGMA * np.random.default_rng(4).standard_normal(len(error))
    session = circles.session(circles.length(error) + noise, length_uncertainty=known)
    fitted, result = fit_sessions(session), identify(session)
    published = {(one["setup"], one["name"]): one for one in result.error_map.content["figures"]}

    def judged(tolerances: dict[str, float], enters: str, u: float) -> dict[str, Verdict]:
        budget = propagate(fitted, [contributor(enters, u)])
        return {one.name: one for one in conformity(fitted, tolerances, budget=budget).each}

    def contributor(enters: str, u: float) -> Contributor:
        return Contributor(name=enters, type="B", standard_uncertainty=u, enters=enters, varies="never")

    tolerances = {"G_b": 5e-6, "F_max_cw.XY": 5e-6, "D": 2e-6}
    found = judged(tolerances, "length", 1e-15)
    assert list(found) == ["G_b.XY", "G_b.YZ", "F_max_cw.XY", "D.XY", "D.YZ"]
    assert {name: one.decision for name, one in found.items()} == {
        "G_b.XY": "fail", "G_b.YZ": "pass", "F_max_cw.XY": "pass", "D.XY": "pass", "D.YZ": "pass"
    }  # fmt: skip
    assert abs(found["G_b.XY"].value - squareness * RADIUS) < 2.0 * found["G_b.XY"].u + 4.0 * SIGMA
    for name, one in found.items():
        figure, _, setup = name.partition(".")
        assert (one.value, one.u) == pytest.approx(
            [published[setup, figure][k] / n for k, n in (("value", 1), ("U", 2))]
        )
    # What all readings have in common is none of a range, and all of a length.
    longer = judged(tolerances, "reading", 3e-6)
    assert longer["G_b.XY"].u == pytest.approx(found["G_b.XY"].u, rel=1e-6)
    assert longer["D.XY"].u == pytest.approx(np.hypot(found["D.XY"].u, 3e-6), rel=1e-2)
    assert longer["D.XY"].decision == "undecided"
    more = completed(result, propagate(fitted, [contributor("reading", 3e-6)])).error_map.content["figures"]
    stated = {(one["setup"], one["name"]): one["U"] / 2.0 for one in more}
    for name, one in longer.items():
        assert stated[name.partition(".")[2], name.partition(".")[0]] == pytest.approx(one.u, rel=1e-6)
    followed = {size.name: size for size in sizes_of(result)}
    assert followed["G_b.XY"].value == published["XY", "G_b"]["value"]
    assert {"G_ccw.XY", "G_cw.YZ", "H.XY"} <= followed.keys()
    with pytest.raises(ModelError, match=r"'G' is no figure .* G_ccw, .* of ISO 230-4 \(G_b.XY for one setup\)"):
        conformity(fitted, {"G": 1e-6})
