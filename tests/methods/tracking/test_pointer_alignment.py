# SPDX-License-Identifier: Apache-2.0
"""Rotation centre and zero angle of a pointer, from exact geometry and from figures worked out by hand."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.cli.align_pointer import command
from machine_tool_calibration.errors import CalibrationError, ModelError, SessionError
from machine_tool_calibration.importing.own import read_alignment
from machine_tool_calibration.methods.tracking.pointer_alignment import rotation_centre, zero_angle
from machine_tool_calibration.procedure import plan, read_procedure
from machine_tool_calibration.procedure.steps import pointing
from machine_tool_calibration.session.description import TrackingInterferometer
from machine_tool_calibration.session.parse import parse_description
from machine_tool_calibration.simulation.sensors import Pointer, sensed_path
from machine_tool_calibration.simulation.site import Site, SiteSpec

CONFIG = Path(__file__).parents[3] / "config" / "procedures"
CENTRE = np.array([-0.3501, 0.0502, 0.0])
PLACE = np.array([-0.35, 0.05])
TURN = np.radians(np.arange(0.0, 360.0, 10.0))


def path(azimuth: Array, target: Array, pointer: Pointer) -> Array:
    """What an interferometer reads of a retroreflector, by the geometry of the simulation."""
    targets = np.broadcast_to(target, (len(azimuth), 3))
    return sensed_path(targets, *pointer.beam(azimuth, np.zeros(len(azimuth)), CENTRE)) - 0.1


def test_a_turn_about_the_centre_by_hand() -> None:
    # Eccentricity of 3 and -4 um: the path changes by 3 cos - 4 sin um, whatever its zero.
    reading = 3e-6 * np.cos(TURN) - 4e-6 * np.sin(TURN) + 7e-5
    found = rotation_centre(TURN, reading, PLACE)
    assert found.offset == pytest.approx([3e-6, -4e-6], abs=1e-13)
    assert found.centre == pytest.approx([-0.350003, 0.050004], abs=1e-13)
    # Alternating +1, -1 um is scatter: u^2 of a coefficient is 2 s^2 / n, s^2 = 36 um^2 / (36 - 3).
    scattered = rotation_centre(TURN, reading + 1e-6 * (-1.0) ** np.arange(36), PLACE)
    assert scattered.scatter == pytest.approx(1e-6 * np.sqrt(36 / 33))
    assert scattered.u == pytest.approx([1e-6 * np.sqrt(2 / 33)] * 2)
    with_machine = rotation_centre(TURN, reading, PLACE, machine=5e-6)
    assert with_machine.u == pytest.approx([5e-6, 5e-6])


def test_radial_error_motion_moves_no_centre_of_a_full_turn() -> None:
    pointer = Pointer(radial={2: (1e-6, 0.0), 3: (0.0, 1e-6)}, eccentricity=3e-4)
    found = rotation_centre(TURN, path(TURN, np.append(PLACE, 0.0), pointer), PLACE)
    assert found.centre == pytest.approx(CENTRE[:2], abs=1e-12)
    assert found.radial == pytest.approx(1e-6, rel=0.5)
    assert found.contributions["radial error motion of the axis"].max() < 1e-12


@pytest.mark.long
def test_half_a_turn_takes_radial_error_motion_for_eccentricity_and_says_so(many: Any) -> None:
    rng = np.random.default_rng(5)
    half = np.linspace(0.0, np.pi, 73)
    squares = []
    for _ in range(6 * many.count):
        waves = {order: tuple(5e-7 * rng.normal(size=2)) for order in range(2, 6)}
        reading = path(half, np.append(PLACE, 0.0), Pointer(radial=waves)) + 1e-8 * rng.normal(size=73)
        found = rotation_centre(half, reading, PLACE)
        off = found.centre - CENTRE[:2]
        squares.append(off @ np.linalg.solve(found.covariance, off) / 2)
    # Half of what is chi-square with two degrees of freedom, over these: below 0.69 in half of all cases.
    assert np.median(squares) == pytest.approx(np.log(2), abs=many.off(0.1))
    assert found.contributions["radial error motion of the axis"].min() > 1e-7
    with pytest.raises(ModelError, match="turns by 90° only"):
        rotation_centre(half / 2, path(half / 2, np.append(PLACE, 0.0), Pointer()), PLACE)


def test_unequal_azimuths_against_an_explicit_covariance() -> None:
    """Generalised least squares and the restricted likelihood with the whole matrix, for every ratio of variances."""
    rng = np.random.default_rng(3)
    azimuth = np.sort(rng.uniform(0.0, 1.3 * np.pi, 40))
    run = np.arange(40) % 2
    waves = np.column_stack([wave(k * azimuth) for k in range(2, 7) for wave in (np.cos, np.sin)])
    reading = waves @ (3e-7 * rng.normal(size=10)) + 1e-7 * rng.normal(size=40) + 1e-5 * np.cos(azimuth) + 2e-4 * run
    model = np.column_stack([np.cos(azimuth), np.sin(azimuth), run == 0, run == 1]).astype(float)
    values, noise, leaked, logs, variances = [], [], [], [], []
    ratios = 10.0 ** np.linspace(-8.0, 8.0, 81)
    for ratio in ratios:
        inverse = np.linalg.inv(np.eye(40) + ratio * waves @ waves.T)
        estimator = np.linalg.solve(model.T @ inverse @ model, model.T @ inverse)
        rest = reading - model @ estimator @ reading
        variances.append(rest @ inverse @ rest / 36)
        determinants = np.linalg.slogdet(inverse)[1] - np.linalg.slogdet(model.T @ inverse @ model)[1]
        # Flat in the size of the waves, whose square the ratio is.
        logs.append(0.5 * (determinants - 36 * np.log(variances[-1]) + np.log(ratio)))
        values.append(estimator @ reading)
        noise.append(variances[-1] * estimator @ estimator.T)
        leaked.append(variances[-1] * ratio * (estimator @ waves) @ (estimator @ waves).T)
    share = np.exp(np.array(logs) - max(logs))
    share /= share.sum()
    assert np.count_nonzero(share > 0.05) > 2
    mean = share @ np.array(values)
    away = np.array(values) - mean
    parts = np.tensordot(share, noise, 1), np.tensordot(share, leaked, 1) + away.T @ (away * share[:, None])
    found = rotation_centre(azimuth, reading, PLACE, run)
    assert found.offset == pytest.approx(mean[:2], rel=1e-6)
    assert found.covariance == pytest.approx(sum(parts)[:2, :2], rel=1e-4)
    assert found.contributions["scatter of the readings"] == pytest.approx(np.sqrt(np.diag(parts[0])[:2]), rel=1e-4)
    assert found.scatter == pytest.approx(np.sqrt(share @ variances), rel=1e-6)
    # Five orders, each with a mean square of one of its two variances.
    assert found.radial == pytest.approx(np.sqrt(5 * share @ (np.array(variances) * ratios)), rel=1e-4)
    assert found.residuals == pytest.approx(reading - model @ mean, abs=1e-12)


def test_each_run_counts_from_its_own_zero() -> None:
    run = np.repeat([0, 1], 36)
    both = np.tile(TURN, 2)
    found = rotation_centre(both, 2e-6 * np.cos(both) + 1e-3 * run, PLACE, run)
    assert found.offset == pytest.approx([2e-6, 0.0], abs=1e-12)


Y = np.linspace(0.048, 0.052, 9)


def test_the_zero_angle_by_hand() -> None:
    # 0.4 um over 4 mm are 100 urad.
    found = zero_angle(Y, 1e-4 * (Y - 0.05), np.zeros(9))
    assert found.offset == pytest.approx(1e-4, rel=1e-8)
    # +1, -2, +1 nm repeated is beside constant and slope: s^2 = 18 nm^2 / (9 - 2), and the sum over (y - mean)^2 is
    # 60 x (0.5 mm)^2.
    wave = 1e-9 * np.tile([1.0, -2.0, 1.0], 3)
    scattered = zero_angle(Y, 1e-4 * (Y - 0.05) + wave, np.zeros(9))
    assert scattered.offset == pytest.approx(1e-4, rel=1e-8)
    assert scattered.u == pytest.approx(1e-9 * np.sqrt(18 / 7) / (5e-4 * np.sqrt(60.0)))


def test_the_zero_angle_of_beams_held_in_two_directions() -> None:
    """An oblique beam tells it by the cosine; readings of two directions never share a zero."""
    azimuth, y = np.repeat([0.7, -1.1], 9), np.tile(Y, 2)
    wave = 1e-9 * np.tile([1.0, -2.0, 1.0], 6)
    reading = y * np.sin(azimuth + 1e-4) + np.repeat([0.3, -0.2], 9) + wave
    for run in (None, np.zeros(18, dtype=np.int64)):
        found = zero_angle(y, reading, azimuth, run)
        assert found.offset == pytest.approx(1e-4, rel=1e-7)
        assert found.scatter == pytest.approx(1e-9 * np.sqrt(36 / 15))
        weight = 60.0 * 5e-4**2 * np.sum(np.cos([0.7001, -1.0999]) ** 2)
        assert found.u == pytest.approx(found.scatter / np.sqrt(weight), rel=1e-6)
        assert found.residuals == pytest.approx(wave, abs=1e-14)


@pytest.mark.parametrize("azimuth", [0.0, 0.7, np.pi, -2.5])
def test_the_zero_angle_by_geometry(azimuth: float) -> None:
    held = np.full(9, azimuth)
    targets = np.column_stack([np.full(9, 0.1), Y, np.zeros(9)])
    origin, beam = Pointer(zero_offset=2e-4).beam(held, np.zeros(9), CENTRE)
    assert zero_angle(Y, sensed_path(targets, origin, beam), held).offset == pytest.approx(2e-4, abs=1e-11)


def test_the_zero_angle_turns_the_eccentricity_and_adds_its_uncertainty() -> None:
    pointer = Pointer(zero_offset=0.01)
    reading = path(TURN, np.append(PLACE, 0.0), pointer)
    wave = 2e-8 * np.tile([1.0, -2.0, 1.0], 3)
    zero = zero_angle(Y, np.sin(0.01) * Y + wave, np.zeros(9))
    found = rotation_centre(TURN, reading, PLACE, zero=zero)
    assert found.centre == pytest.approx(CENTRE[:2], abs=1e-9)
    across = np.abs(PLACE - CENTRE[:2])[::-1]
    assert found.contributions["zero angle of the pointer"] == pytest.approx(zero.u * across, rel=1e-3)


def test_what_does_not_tell_is_refused() -> None:
    with pytest.raises(ModelError, match="nearly along Y"):
        zero_angle(Y, Y, np.full(9, 1.5))
    with pytest.raises(ModelError, match="Y does not move"):
        zero_angle(np.full(9, 0.1), Y, np.zeros(9))
    with pytest.raises(ModelError, match="two opposite azimuths"):
        rotation_centre(np.tile([0.0, np.pi], 9), np.zeros(18), PLACE)
    with pytest.raises(ModelError, match="too few readings"):
        rotation_centre(TURN[::12], TURN[::12], PLACE)


def written(folder: Path, name: str, columns: dict[str, Array]) -> Path:
    table = np.column_stack(list(columns.values()))
    np.savetxt(folder / name, table, delimiter=",", header=",".join(columns), comments="", fmt="%.12g")
    return folder / name


def test_the_verb_prints_lines_for_the_session(tmp_path: Path) -> None:
    still = {"x": np.full(36, PLACE[0]), "y": np.full(36, PLACE[1])}
    turn = {"azimuth": TURN, **still, "displacement": path(TURN, np.append(PLACE, 0.0), Pointer())}
    line = {"azimuth": np.zeros(9), "x": np.full(9, 0.1), "y": Y, "displacement": 1e-4 * Y}
    files = [str(written(tmp_path, "turn.csv", turn)), str(written(tmp_path, "line.csv", line))]
    document = json.loads(CliRunner().invoke(command, [*files, "--machine", "5um", "--json"]).stdout)
    assert document["zero_angle"]["value"] == pytest.approx(1e-4, rel=1e-6)
    assert document["centre"]["position_u"] == pytest.approx([5e-6, 5e-6], rel=1e-3)
    shown = CliRunner().invoke(command, [files[0], "--setup", "B"]).output
    assert "say how large with --machine" in shown
    setups = shown[shown.index("setups:") :]
    text = (
        "format: mtcal-session/1\nmethod: tracking_interferometer\ndimension: 2\npointing: open_loop\n"
        f"machine: {{chain: w-b-Y-X-Z-t}}\nstandard_uncertainty: {{displacement: 1.0e-6}}\n{setups}"
    )
    description = parse_description(text, "printed").as_a(TrackingInterferometer)
    assert description.setups[0].position[:2] == pytest.approx(CENTRE[:2], abs=1e-7)
    twice = CliRunner().invoke(command, [files[0], files[0]])
    assert isinstance(twice.exception, CalibrationError) and "at most one search" in str(twice.exception)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"azimuth": TURN, "y": TURN}, "the beam turns and the retroreflector moves"),
        ({}, "neither beam nor retroreflector moves"),
        ({"x": TURN}, "x moves"),
        ({"azimuth": TURN, "setup": np.arange(36) // 18}, "2 setups; each station has a centre of its own"),
        ({"y": np.where(TURN > 1.0, np.nan, 0.0)}, "that is missing"),
    ],
)
def test_a_file_of_another_kind_is_one_line(change: dict[str, Array], message: str, tmp_path: Path) -> None:
    columns = {name: np.zeros(36) for name in ("azimuth", "x", "y", "displacement")} | change
    with pytest.raises(SessionError, match=message):
        read_alignment(written(tmp_path, "search.csv", columns))


def searched(name: str, site: Site, folder: Path) -> Path:
    """What a procedure of the package reads in a simulated workshop, by its geometry, as a CSV."""
    procedure = read_procedure(CONFIG / f"{name}.yaml")
    (setup,) = procedure.session.setups
    station = site.station(procedure.session, 0)
    rows = []
    for step in plan(procedure).steps:
        moment = site.moment(0.0, step.position, step.direction)
        azimuth = float(pointing(np.array([step.aim]), np.array(setup.position))[0][0])
        beam = site.true_beam(moment, azimuth, 0.0, station)
        read = (site.functional_point(moment)[0] - beam.origin) @ beam.direction
        rows.append([azimuth, step.position["x"], step.position["y"], step.repeat, read])
    names = ("azimuth", "x", "y", "repeat", "displacement")
    return written(folder, f"{name}.csv", dict(zip(names, np.array(rows).T, strict=True)))


def test_the_procedures_of_the_package_find_the_pointer_of_a_workshop(tmp_path: Path) -> None:
    spec = {
        "seed": 4,
        "machine": {"chain": "w-C-b-Y-X-Z-t", "travel": {"x": [-0.4, 0.4], "y": [0.0, 0.4], "z": [0.0, 0.05]}},
        "pointer": {"zero_offset": 2e-4, "radial": {2: (1e-6, 5e-7), 3: (-3e-7, 6e-7)}, "eccentricity": 1e-4},
    }
    site = Site(SiteSpec.model_validate(spec))
    turn, line = (read_alignment(searched(name, site, tmp_path)) for name in ("pointer_centre", "pointer_zero"))
    zero = zero_angle(line.place[:, 1], line.displacement, line.azimuth, line.run)
    # The normal of Y is that of the line on which the tool really moves there.
    ends = [site.functional_point(site.moment(0.0, {"x": 0.1, "y": y, "z": 0.0}))[0] for y in (0.0485, 0.0515)]
    lean = float((ends[1] - ends[0])[0] / (ends[1] - ends[0])[1])
    assert zero.offset == pytest.approx(2e-4 + lean, abs=1e-6)
    centre = rotation_centre(turn.azimuth, turn.displacement, turn.place[0], turn.run, machine=5e-6, zero=zero)
    station = site.station(read_procedure(CONFIG / "pointer_centre.yaml").session, 0)[:2]
    stands = site.functional_point(site.moment(0.0, {"x": -0.35, "y": 0.05, "z": 0.0}))[0, :2]
    # What is left is where the machine really stands, and the eccentricity turned by the lean of Y.
    assert centre.centre - station == pytest.approx(turn.place[0] - stands, abs=2e-8)
    assert (np.abs(centre.centre - station) < 3.0 * centre.u).all()
