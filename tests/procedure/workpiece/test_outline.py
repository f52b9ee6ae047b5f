# SPDX-License-Identifier: Apache-2.0
"""Segments and contours: points on them, outward normals, what the stylus reaches."""

import numpy as np
import pytest

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.procedure.workpiece.outline import (
    Arc,
    Contour,
    Straight,
    join,
    polygon,
    probe_points,
    reachable,
)


def square(half=0.05, clockwise=False):
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    if clockwise:
        corners.reverse()
    return Contour(tuple(Straight(a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)), True)


@pytest.mark.parametrize("clockwise", [False, True])
def test_normals_point_out_of_the_material(clockwise):
    contour = square(clockwise=clockwise)
    assert np.sign(contour.area) == (-1 if clockwise else 1)
    block = probe_points(contour, "inside", 0.01)
    assert len(block.position) == 40
    assert np.all(np.sum(block.position * block.normal, axis=1) == pytest.approx(0.05))
    pocket = probe_points(contour, "outside", 0.01)
    np.testing.assert_allclose(pocket.normal, -block.normal)
    np.testing.assert_allclose(pocket.position, block.position)


def test_points_keep_off_corners():
    touched = probe_points(square(), "inside", 0.03)
    nearest = np.min(np.linalg.norm(np.abs(touched.position) - 0.05, axis=1))
    assert nearest > 0.01


def test_area_of_arcs():
    half_disc = Contour((Arc((0.0, 0.0), 0.1, 0.0, np.pi), Straight((-0.1, 0.0), (0.1, 0.0))), True)
    assert half_disc.area == pytest.approx(0.5 * np.pi * 0.01)
    disc = Contour((Arc((0.2, 0.1), 0.1, 1.0, -2 * np.pi),), True)
    assert disc.area == pytest.approx(-np.pi * 0.01)
    # A third of a disc, off the origin: its arc is no half of a circle, whose chord runs through the centre.
    slice_ = Arc((0.2, 0.1), 0.1, 0.3, 2 * np.pi / 3)
    sides = Straight(slice_.end, slice_.centre), Straight(slice_.centre, slice_.start)
    assert Contour((slice_, *sides), True).area == pytest.approx(np.pi * 0.01 / 3)


def test_open_outline_has_no_inside():
    wall = Contour((Straight((0.0, 0.0), (0.1, 0.0)),), False)
    np.testing.assert_allclose(probe_points(wall, "left", 0.02).normal, [[0, -1]] * 5, atol=1e-15)
    with pytest.raises(SessionError, match="an open outline has no inside"):
        probe_points(wall, "inside", 0.02)


def test_segments_are_joined_in_any_order_and_direction():
    pieces = list(square().segments)
    pieces[1] = pieces[1].turned_back()
    pieces = [pieces[k] for k in (2, 0, 3, 1)]
    other = Arc((0.5, 0.0), 0.1, 0.3, 2 * np.pi)
    contours = join([pieces[0], other, *pieces[1:]])
    assert sorted(len(c.segments) for c in contours) == [1, 4]
    assert all(c.is_closed for c in contours)
    assert abs(next(c for c in contours if len(c.segments) == 4).area) == pytest.approx(0.01)
    assert [c.is_closed for c in join(pieces[:3])] == [False]


def test_smooth_curves_are_sampled_across_their_segments():
    angle = np.linspace(0, 2 * np.pi, 721)
    corners = [(0.1 * float(np.cos(a)), 0.1 * float(np.sin(a))) for a in angle[:-1]]
    polygon = Contour(tuple(Straight(a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)), True)
    touched = probe_points(polygon, "inside", 0.02)
    assert len(touched.position) == 31
    radial = touched.position / np.linalg.norm(touched.position, axis=1)[:, None]
    assert np.max(np.abs(touched.normal - radial)) < 5e-3


def test_distance_from_an_arc():
    arc = Arc((0.0, 0.0), 1.0, 0.0, np.pi / 2)
    points = np.array([[2.0, 0.0], [0.5, 0.5], [0.0, -1.0], [-1.0, 0.0]])
    np.testing.assert_allclose(arc.distance(points), [1.0, 1 - np.hypot(0.5, 0.5), np.sqrt(2), np.sqrt(2)], atol=1e-12)
    back = arc.turned_back()
    assert back.sweep < 0
    np.testing.assert_allclose(back.distance(points), arc.distance(points), atol=1e-12)


def test_stylus_does_not_reach_into_corners():
    contour = square()
    pocket = probe_points(contour, "outside", 0.001)
    free = reachable(pocket, contour.segments, stylus_radius=0.003)
    corner = np.min(0.05 - np.abs(pocket.position) + (np.abs(pocket.position) > 0.0499), axis=1)
    assert np.array_equal(free, corner >= 0.003 - 1e-6)
    kept = reachable(pocket, contour.segments, stylus_radius=0.003, clearance=0.001)
    assert np.array_equal(kept, corner >= 0.004 - 1e-6)  # from other walls than the one that it touches
    block = probe_points(contour, "inside", 0.001)
    assert reachable(block, contour.segments, stylus_radius=0.003).all()


@pytest.mark.parametrize("closed", [False, True])
def test_corners_that_span_nothing_are_refused(closed):
    corners = [(0.0, 0.0), (0.1, 0.0)] if closed else [(0.0, 0.0), (0.0, 0.0)]
    with pytest.raises(SessionError, match="three different corners"):
        probe_points(polygon(corners, closed=closed), "left", 0.008)
