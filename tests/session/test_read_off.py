# SPDX-License-Identifier: Apache-2.0
"""Positions that were read off are taken for the places about which they scatter; what was commanded stays as it is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.recording.open import open_measurement
from machine_tool_calibration.recording.session_bag import session_to_bag
from machine_tool_calibration.session.checks.suspicion import suspicions
from machine_tool_calibration.session.description import Place
from machine_tool_calibration.session.folder import read_session, write_session
from machine_tool_calibration.session.read_off import commanded
from machine_tool_calibration.session.session import Session, assemble, joined
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate

PLACES = np.repeat(np.linspace(0.0, 0.4, 5), 6)


def of_x(position: np.ndarray) -> np.ndarray:
    return commanded({"x": position})["x"]


@pytest.mark.parametrize("scatter", [1e-8, 1e-7, 4e-6, 4e-5])
def test_repeats_of_a_place_are_one_place(scatter: float) -> None:
    read = PLACES + scatter * np.random.default_rng(1).uniform(-1.0, 1.0, len(PLACES))
    taken = of_x(read)
    assert len(np.unique(taken)) == 5
    assert np.abs(taken - PLACES).max() < (scatter if scatter < 1e-7 else 1e-15)


def test_angles_are_round_in_degrees() -> None:
    angle = np.radians(np.repeat(np.arange(0.0, 360.0, 20.0), 4))
    read = angle + 2e-6 * np.random.default_rng(4).uniform(-1.0, 1.0, len(angle))
    assert np.abs(commanded({"c": read})["c"] - angle).max() < 1e-12


@pytest.mark.parametrize("scatter", [1e-8, 1e-6, 2e-5])
def test_an_axis_that_stands_while_others_move_is_at_one_place(scatter: float) -> None:
    still = scatter * np.random.default_rng(6).uniform(-1.0, 1.0, len(PLACES))
    taken = commanded({"x": PLACES, "y": still, "z": 0.2 + still})
    assert np.unique(taken["y"]).tolist() == [0.0]
    assert not np.signbit(taken["y"]).any()
    assert np.unique(taken["z"]) == pytest.approx([0.2], abs=scatter)
    np.testing.assert_array_equal(taken["x"], PLACES)


@pytest.mark.parametrize(
    "position",
    [
        PLACES,
        PLACES + 1e-12 * np.arange(30),  # written alike
        np.repeat(np.linspace(0.0, 2e-6, 11), 3),  # a stage that moves by fractions of a micrometre
        np.concatenate([at + np.arange(20) * 1e-6 for at in (0.0, 0.1, 0.2)]),  # fine steps at some places
        np.cumsum(np.random.default_rng(2).uniform(0.5, 1.5, 200)) * 1e-5,  # on the move
        np.append(np.linspace(0.0, 0.4, 21), 0.4 + 1e-6),  # hardly any place was read again
        np.append(PLACES[:-1], np.nan),
        np.zeros(0),
    ],
)
def test_other_positions_stay_as_they_are(position: np.ndarray) -> None:
    np.testing.assert_array_equal(of_x(position), position)


def read_off(session: Session, scatter: float) -> Session:
    """The same measurement where the axes stood beside the places, as their encoders say and the instrument reads."""
    rng, readings = np.random.default_rng(3), session.readings
    beside = scatter * rng.uniform(-1.0, 1.0, (len(readings), 2))
    beam = build_model(session)[0].observations.direction[:, :2]
    read = readings.displacement + np.sum(beam * beside, axis=1)
    columns = dict(readings.columns) | {"repeat": readings.repeat.astype(float), "displacement": read}
    columns |= {axis: columns[axis] + own for axis, own in zip("xy", beside.T, strict=True)}
    labels = {**readings.labels, "setup": np.array(session.setup_ids)[readings.setup]}
    return replace(session, readings=assemble(session.description, columns, labels, Place("s", "s")))


def test_a_measurement_with_encoder_positions_gives_the_same_map_and_says_what_was_taken() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["tracking_2d"], seed=5)).session
    other = read_off(session, 5e-6)
    wanted, found = identify(session).error_map, identify(other).error_map
    assert found.error == pytest.approx(wanted.error, abs=1e-9, nan_ok=True)
    assert found.uncertainty == pytest.approx(wanted.uncertainty, rel=1e-6, nan_ok=True)
    assert suspicions([session]) == []
    assert [words.split()[2] for words in suspicions([other])] == ["x", "y"]
    assert all(2.5e-6 < np.abs(off).max() < 1e-5 for off in other.readings.off_place.values())
    some = other.readings.select(np.arange(3))
    np.testing.assert_array_equal(joined([some, some]).off_place["x"][3:], other.readings.off_place["x"][:3])


@pytest.mark.parametrize("name", ["tracking_3d", "step_diagonal"])
def test_it_is_written_as_it_was_read_and_carried_over_to_the_places(name: str, tmp_path: Path) -> None:
    session = simulate(SimulationSpec(plan=PRESETS[name], seed=5)).session
    other = read_off(session, 2e-6)
    write_session(other, tmp_path / "session")
    session_to_bag(other, tmp_path / "bag")
    plain = identify(session)
    for found in (other, read_session(tmp_path / "session"), open_measurement(tmp_path / "bag")):
        result = identify(found)
        assert result.rms_residual == pytest.approx(plain.rms_residual, rel=1e-3)
        assert result.error_map.error == pytest.approx(plain.error_map.error, abs=1e-9, nan_ok=True)
