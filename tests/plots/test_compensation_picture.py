# SPDX-License-Identifier: Apache-2.0
"""The picture of what tables leave of the errors."""

import numpy as np

from machine_tool_calibration.export.compensation import ResidualErrors
from machine_tool_calibration.plots.maps import draw_compensation


def test_marks_and_band_are_the_errors_and_twice_their_uncertainty() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.2, 0.0]])
    before, after = np.zeros((3, 3)), np.zeros((3, 3))
    before[:, 0], after[:, 0] = (1e-6, 2e-6, -4e-6), (1e-7, 0.0, -3e-7)
    known = np.tile([True, True, False], (3, 1))
    figure = draw_compensation(ResidualErrors(points, before, after, np.full((3, 3), 2e-7) * known, known), "isg: s")
    panels = figure.axes
    assert [panel.get_ylabel() for panel in panels[::2]] == [
        "error along X, µm",
        "error along Y, µm",
        "length of the error, µm",
    ]
    assert [panel.get_xlabel() for panel in panels[-2:]] == ["X, mm", "Y, mm"]
    first, second = panels[0].get_lines()[:2]
    assert np.allclose(first.get_ydata(), [1.0, 2.0, -4.0])
    assert np.allclose(second.get_ydata(), [0.1, 0.0, -0.3])
    band = panels[0].collections[0].get_paths()[0].vertices
    assert np.allclose([band[:, 1].min(), band[:, 1].max()], [-0.4, 0.4])
    lengths = panels[4].collections[0].get_paths()[0].vertices
    assert np.allclose([lengths[:, 1].min(), lengths[:, 1].max()], [0.0, 0.4 * np.sqrt(2)])


def test_a_long_title_of_a_narrow_picture_stays_in_it() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    errors = ResidualErrors(points, np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3)), np.ones((2, 3), dtype=bool))
    figure = draw_compensation(errors, "siemens: x")
    figure.draw_without_rendering()
    assert figure.texts[0].get_window_extent().width <= figure.bbox.width
