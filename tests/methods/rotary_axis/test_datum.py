# SPDX-License-Identifier: Apache-2.0
"""Datum of a rotary axis on tables that are small enough to work out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.methods.rotary_axis.datum import (
    covered_angle,
    motion_constraints,
    open_directions,
    target_constraints,
    unseen_motions,
    unseen_names,
    unsensed_motions,
)
from machine_tool_calibration.methods.rotary_axis.geometry import TableReadings, axis_rotation
from machine_tool_calibration.session.session import Readings

ANGLES = np.radians([0.0, 90.0, 210.0])
SIZE = 0.2
LABELS = [[f"{motion}({k})" for k in range(len(ANGLES))] for motion in ("EX", "EY", "EZ", "EA", "EB", "EC")]


def table(axis: str, node: Array, run: Array, sign: int = 1) -> TableReadings:
    """A table turned to those of the angles, the readings in those runs."""
    node, run, n = np.asarray(node), np.asarray(run), len(node)
    readings = Readings(np.zeros(n, dtype=int), np.zeros(n, dtype=int), np.zeros(n), {}, {}, np.arange(n))
    turned = axis_rotation(axis, sign * ANGLES)
    key = np.column_stack([np.unique(run), np.unique(run), np.unique(run)])
    first = np.unique(run, return_index=True)[1]
    return TableReadings(axis, readings, ANGLES, node, turned[node], turned, np.zeros(n, dtype=int), run, key, first)


def test_a_target_seen_from_three_sides_leaves_the_turns_about_it() -> None:
    """At the first angle; at the second a station is missing, at the third two of three runs have a single reading."""
    arm = np.tile([0.3, -0.1, 0.2], (8, 1))
    sides = np.eye(3)[[0, 1, 2, 0, 1, 0, 1, 2]]
    unsensed = unsensed_motions(table("C", [0, 0, 0, 1, 1, 2, 2, 2], [0, 1, 2, 0, 1, 2, 3, 4]), sides, arm, SIZE)
    about = [np.r_[np.cross(arm[0], turn), SIZE * turn] for turn in np.eye(3)]  # t + turn x arm = 0
    for motion in about:
        np.testing.assert_allclose(unsensed[0] @ motion, motion, atol=1e-12)
    assert np.trace(unsensed[0]) == pytest.approx(3.0)
    assert np.trace(unsensed[1]) == pytest.approx(4.0)
    # Z is not looked along at the second angle: to rise does not show there.
    np.testing.assert_allclose(unsensed[1] @ np.eye(6)[2], np.eye(6)[2], atol=1e-12)
    # At the third angle the run that has read elsewhere, too, looks along X.
    assert np.trace(unsensed[2]) == pytest.approx(5.0)
    along = np.r_[sides[5], np.cross(arm[5], sides[5]) / SIZE]
    np.testing.assert_allclose(unsensed[2] @ along, 0.0, atol=1e-12)


@pytest.mark.parametrize(("axis", "sign", "across"), [("A", 1, (1, 2)), ("B", -1, (2, 0)), ("C", 1, (0, 1))])
def test_constants_and_what_turns_with_the_axis_are_open(axis: str, sign: int, across: tuple[int, int]) -> None:
    found = open_directions(table(axis, [0, 1, 2], [0, 0, 0], sign))
    np.testing.assert_array_equal(found[:, :, :6], np.repeat(np.eye(6)[:, None], 3, axis=1))
    i, j = across
    cos, sin = np.cos(ANGLES), sign * np.sin(ANGLES)
    for block, first in ((0, 6), (3, 8)):
        expected = np.zeros((6, 3, 2))
        expected[block + i, :, 0], expected[block + j, :, 0] = cos, sin
        expected[block + i, :, 1], expected[block + j, :, 1] = -sin, cos
        np.testing.assert_allclose(found[:, :, first : first + 2], expected, atol=1e-15)


def test_motions_that_are_seen_hold_none_of_these() -> None:
    """Ten conditions that together forbid just the open directions."""
    readings = table("C", [0, 1, 2], [0, 0, 0])
    conditions = motion_constraints(readings, LABELS, np.zeros((3, 6, 6)), SIZE)
    names = [label for row in LABELS for label in row]
    rows = np.array([[condition.weights.get(name, 0.0) for name in names] for condition in conditions])
    np.testing.assert_allclose(rows, open_directions(readings).reshape(18, 10).T, atol=1e-12)
    assert all(condition.value == 0.0 for condition in conditions)


@pytest.mark.parametrize(
    ("one", "other", "parts"),
    [
        (3, 4, (1.0, 1.0)),  # a line through the axis
        (1, 5, (0.6, 0.8)),  # a line that is beside it
    ],
)
def test_where_a_motion_is_seen_in_part_the_condition_is_on_that_part(
    one: int, other: int, parts: tuple[float, float]
) -> None:
    """Nowhere is a turn about a line seen on which both targets lie: turns times the size, and shifts."""
    scaled = parts / np.linalg.norm(parts)
    line = np.zeros(6)
    line[[one, other]] = scaled
    unsensed = np.tile(np.outer(line, line), (3, 1, 1))
    conditions = motion_constraints(table("C", [0, 1, 2], [0, 0, 0]), LABELS, unsensed, SIZE)
    names = [label for row in LABELS for label in row]
    rows = np.array([[condition.weights.get(name, 0.0) for name in names] for condition in conditions])
    # What is not seen is not touched by any of them, and what is has no constant.
    unit = np.repeat([1.0, 1.0 / SIZE], 3)[:, None]
    unseen = np.zeros((6, 3))
    unseen[[one, other]] = scaled[:, None]
    np.testing.assert_allclose(rows @ (unit * unseen).ravel(), 0.0, atol=1e-12)
    seen = np.zeros((6, 3))
    seen[one], seen[other] = scaled[1], -scaled[0]
    seen *= unit
    assert np.abs(rows @ seen.ravel()).max() > 1e-3
    assert np.linalg.matrix_rank(rows) >= 6


def test_targets_have_their_nominal_height_and_angle_on_the_average() -> None:
    nominal = np.array([[0.1, 0.0, 0.02], [0.0, 0.3, 0.05], [0.2, 0.2, 0.7]])
    reference = nominal + np.array([[1e-3, 2e-3, 3e-3], [-4e-3, 1e-3, 5e-3], [0.5, 0.5, 0.5]])
    names = [f"{target}{axis}" for target in "PQK" for axis in "xyz"]
    height, angle = target_constraints(np.eye(3)[2], names, nominal, reference, np.array([True, True, False]))
    assert height.weights == {"Pz": 1.0, "Qz": 1.0}
    assert height.value == pytest.approx(-8e-3)
    # Around: what P moves along y by its radius, and Q against x by its own.
    assert angle.weights == pytest.approx({"Py": 0.1, "Qx": -0.3})
    assert angle.value == pytest.approx(0.1 * -2e-3 - 0.3 * 4e-3)


def test_what_is_unseen_is_held_at_zero_and_named_where_it_counts() -> None:
    """To rise at the second angle, and there almost all of a turn about X."""
    rise, turn = np.eye(6)[2], np.r_[np.zeros(3), np.sqrt(1.0 - 4e-6), 0.0, 2e-3]
    unsensed = np.zeros((3, 6, 6))
    unsensed[1] = np.outer(rise, rise) + np.outer(turn, turn)
    held = {frozenset(prior.weights): prior for prior in unseen_motions(unsensed, LABELS, SIZE)}
    assert set(held) == {frozenset(["EZ(1)"]), frozenset(["EA(1)", "EC(1)"])}
    assert all(prior.value == 0.0 and prior.sigma == 1e-4 for prior in held.values())
    weights = held[frozenset(["EA(1)", "EC(1)"])].weights
    assert abs(weights["EA(1)"]) == pytest.approx(SIZE, rel=1e-5)
    assert weights["EC(1)"] / weights["EA(1)"] == pytest.approx(2e-3, rel=1e-5)
    # 0.1 mm times two thousandths is 0.2 um of EC: a third of 1 um is more, of 0.5 um less.
    assert unseen_names(unsensed, LABELS, 1e-6) == {"EZ(1)", "EA(1)"}
    assert unseen_names(unsensed, LABELS, 5e-7) == {"EZ(1)", "EA(1)", "EC(1)"}


def test_the_turn_that_is_covered_is_the_whole_less_the_largest_gap() -> None:
    every = table("C", [0, 1, 2], [0, 0, 0])
    assert covered_angle(every) == pytest.approx(np.radians(210.0))
    assert covered_angle(replace(every, node=np.array([0, 1, 1]))) == pytest.approx(np.radians(90.0))
