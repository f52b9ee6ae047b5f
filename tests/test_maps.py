# SPDX-License-Identifier: Apache-2.0
"""The error map as a function, from messages of any library."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.maps import FIELDS, PositionErrors, error_map_from_message, error_map_from_points
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.recording.open import open_measurement

DATA = Path(__file__).parent / "data"
SLOPES = np.array([[1e-5, -2e-5, 0.0], [3e-5, 1e-5, 2e-5], [0.0, -1e-5, 4e-5]])


def message(rows: np.ndarray, *, order: str = "<", pad: int = 0, height: int = 1) -> SimpleNamespace:
    """A cloud as any library gives it."""
    step = 72 + pad
    data = np.zeros((len(rows), step), np.uint8)
    data[:, :72] = np.ascontiguousarray(rows).astype(f"{order}f8").view(np.uint8).reshape(len(rows), 72)
    width = len(rows) // height
    return SimpleNamespace(
        header=SimpleNamespace(frame_id="machine"),
        height=height,
        width=width,
        fields=[SimpleNamespace(name=name, offset=8 * k, datatype=8, count=1) for k, name in enumerate(FIELDS)],
        is_bigendian=order == ">",
        point_step=step,
        row_step=step * width,
        data=data.tobytes(),
    )


def grid(*axes: np.ndarray) -> np.ndarray:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def linear(points: np.ndarray) -> np.ndarray:
    return points @ SLOPES.T + np.array([1e-6, 2e-6, -3e-6])


def rows_of(points: np.ndarray) -> np.ndarray:
    return np.hstack([points, linear(points), np.full_like(points, 2e-7)])


VOLUME = grid(np.linspace(0, 0.4, 5), np.linspace(-0.1, 0.1, 3), np.array([0.0, 0.05, 0.2]))


@pytest.mark.parametrize(("order", "pad", "height"), [("<", 0, 1), (">", 0, 1), ("<", 8, 1), ("<", 0, 5)])
def test_a_grid_is_interpolated_from_any_layout(order: str, pad: int, height: int) -> None:
    rows = rows_of(VOLUME)[np.random.default_rng(1).permutation(len(VOLUME))]
    made = error_map_from_message(message(rows, order=order, pad=pad, height=height))
    assert made.kind == "grid" and made.frame == "machine"
    inside = np.random.default_rng(2).uniform([0, -0.1, 0], [0.4, 0.1, 0.2], (100, 3))
    error, uncertainty = made(inside)
    np.testing.assert_allclose(error, linear(inside), atol=1e-18)
    np.testing.assert_allclose(uncertainty, 2e-7)
    one, _ = made(inside[0])
    assert one.shape == (3,) and np.array_equal(one, error[0])


def test_outside_there_is_no_number() -> None:
    made = error_map_from_message(message(rows_of(VOLUME)))
    assert np.isnan(made([0.41, 0.0, 0.1])[0]).all() and np.isnan(made([0.41, 0.0, 0.1])[1]).all()
    with pytest.raises(CalibrationError, match=r"\(410, 0, 100\) mm is outside"):
        made.compensated([0.41, 0.0, 0.1])


def test_scattered_points_within_their_hull() -> None:
    points = np.random.default_rng(3).uniform(0, 0.3, (60, 3))
    made = error_map_from_message(message(rows_of(points)))
    assert made.kind == "scattered"
    centre = points.mean(axis=0)
    np.testing.assert_allclose(made(centre)[0], linear(centre), atol=1e-15)
    assert np.isnan(made([0.0, 0.0, 0.0])[0]).all()


def test_a_plane_holds_for_its_plane() -> None:
    flat = grid(np.linspace(0, 0.4, 6), np.linspace(0, 0.4, 6), np.array([0.03]))
    rows = rows_of(flat)
    rows[:, [5, 8]] = np.nan
    made = error_map_from_message(message(rows))
    assert made.determined == (True, True, False)
    error, _ = made([0.1, 0.2, 0.03])
    np.testing.assert_allclose(error[:2], linear(np.array([0.1, 0.2, 0.03]))[:2])
    assert np.isnan(error[2]) and np.isnan(made([0.1, 0.2, 0.0])[0]).all()
    wide = error_map_from_message(message(rows), flat_tolerance=0.1)
    np.testing.assert_allclose(wide([0.1, 0.2, 0.0])[0][:2], error[:2])
    command = made.compensated([0.1, 0.2, 0.03])
    assert command[2] == 0.03 and command[0] != 0.1


def test_a_single_point_holds_for_its_place() -> None:
    made = error_map_from_message(message(rows_of(VOLUME[7:8])))
    np.testing.assert_allclose(made(np.tile(VOLUME[7], (3, 1)))[0], np.tile(linear(VOLUME[7]), (3, 1)))
    assert np.isnan(made(VOLUME[8])[0]).all()


def test_a_gap_is_no_number() -> None:
    rows = rows_of(VOLUME)
    rows[0, 3] = np.nan
    made = error_map_from_message(message(rows))
    assert np.isnan(made([0.01, -0.09, 0.01])[0][0]) and np.isfinite(made([0.3, 0.05, 0.1])[0]).all()


def test_the_command_brings_the_machine_there() -> None:
    made = error_map_from_message(message(rows_of(VOLUME)))
    wanted = np.random.default_rng(4).uniform([0.01, -0.09, 0.01], [0.39, 0.09, 0.19], (50, 3))
    command = made.compensated(wanted)
    reached = command + linear(command)
    assert np.abs(linear(wanted)).max() > 5e-6
    assert np.abs(reached - wanted).max() < 1e-15
    edge = made.compensated(VOLUME[0])  # the command itself may lie beyond the edge
    assert np.abs(edge + linear(edge) - VOLUME[0]).max() < 1e-9


def test_both_ways_of_approach_give_their_mean() -> None:
    points = np.vstack([VOLUME, VOLUME])
    error = np.vstack([linear(VOLUME) - 1e-6, linear(VOLUME) + 1e-6])
    made = error_map_from_points(points, error, np.full_like(points, 3e-7))
    at, spread = made([0.1, 0.0, 0.1])
    np.testing.assert_allclose(at, linear(np.array([0.1, 0.0, 0.1])))
    np.testing.assert_allclose(spread, np.hypot(1e-6, 3e-7))


def test_maps_of_results() -> None:
    """The step diagonal's lines along the axes add up; a target's own error comes back at the target."""
    result = identify(open_measurement(DATA / "step_diagonal"))
    made = of(result.error_map)
    content = result.error_map.content
    assert made.kind == "axes"
    corner = [content[f"{axis}_position"][4] for axis in "xyz"]
    expected = sum(content[axis][4] for axis in "xyz")
    np.testing.assert_allclose(made(corner)[0], expected, atol=1e-18)
    targets = identify(open_measurement(DATA / "tracking_2d"))
    plane = of(targets.error_map)
    error, uncertainty = plane(targets.error_map.points)
    np.testing.assert_allclose(error[:, :2], targets.error_map.error[:, :2], atol=1e-15)
    np.testing.assert_allclose(uncertainty[:, :2], targets.error_map.uncertainty[:, :2], atol=1e-15)


def of(error_map: object) -> PositionErrors:
    rows = np.hstack([error_map.points, error_map.error, error_map.uncertainty])  # type: ignore[attr-defined]
    return error_map_from_message(message(rows))


def test_a_foreign_cloud_is_refused() -> None:
    good = message(rows_of(VOLUME))
    with pytest.raises(CalibrationError, match="no field 'ux'"):
        error_map_from_message(SimpleNamespace(**{**vars(good), "fields": good.fields[:6]}))
    with pytest.raises(CalibrationError, match="bytes are too few"):
        error_map_from_message(SimpleNamespace(**{**vars(good), "data": good.data[:-1]}))
    with pytest.raises(CalibrationError, match="has 4294967295 points"):
        error_map_from_message(SimpleNamespace(**{**vars(good), "width": 2**32 - 1}))
    wrong = [SimpleNamespace(name=name, offset=8 * k, datatype=7, count=1) for k, name in enumerate(FIELDS)]
    with pytest.raises(CalibrationError, match="not float64"):
        error_map_from_message(SimpleNamespace(**{**vars(good), "fields": wrong}))
    with pytest.raises(CalibrationError, match="neither a plane nor a volume"):
        error_map_from_points(np.eye(3)[[0, 1]] * 0.1, np.zeros((2, 3)), np.zeros((2, 3)))


@pytest.mark.long
def test_needs_no_ros() -> None:
    code = "import sys; import machine_tool_calibration.maps; assert not {'rclpy', 'sensor_msgs'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=900)
