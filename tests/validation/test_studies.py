# SPDX-License-Identifier: Apache-2.0
"""The papers' figures that come out the same, and those that cannot."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from machine_tool_calibration.validation import study_step_diagonal, study_tracking
from machine_tool_calibration.validation.record import Printed, Study


def entry(study: Study, what: str) -> Printed:
    return next(printed for printed in study.printed if printed.what.startswith(what))


def test_a_tilted_mirror_is_behind_table_1_of_the_step_diagonal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_step_diagonal, "_REPEATS", 1)
    study = study_step_diagonal.study(lambda what, share: None)
    differing = [printed.what for printed in study.printed if not printed.agrees]
    # The printed squareness of Y-Z contradicts the printed positioning errors; the two others do not.
    assert differing == ["squareness of Y-Z, conventional less proposed"]
    assert entry(study, "squareness of X-Y, conventional").ours == pytest.approx(4.4e-6, abs=2e-8)


def test_the_budget_and_the_map_of_the_open_loop_tracking_interferometer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_tracking, "compare_fits", partial(study_tracking.compare_fits, draws=80))
    study = study_tracking.study(lambda what, share: None)
    differing = [printed.what for printed in study.printed if printed.agrees is False]
    assert differing == [
        "u_11 wavelength accuracy",
        "all, root sum of squares of the printed u_1 and u_2",
        "all, sum of the printed u_1 and u_2",
        "by the 2.5e-6/K that the text gives for it",
    ]
    # 0.8 mm beside 320 mm: sqrt(320^2 + 0.8^2) - 320 mm.
    assert entry(study, "cosine error").ours == pytest.approx(0.99999e-6, abs=2e-11)
    assert entry(study, "u_1, root sum of squares").ours == pytest.approx(0.232e-6, abs=1e-9)
    assert entry(study, "all, sum of").ours == pytest.approx(2.63e-6, abs=1e-9)
    assert entry(study, "unknowns in the plane").ours == 2 * 20 + 3 * 3 - 3
    assert entry(study, "largest normalised difference |E_n|, expansion corrected").ours < 1.0


def test_the_datum_of_an_origin_and_an_axis() -> None:
    points = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1]])
    shift, turn = np.array([3e-6, -2e-6]), 1e-5
    moved = shift + turn * np.stack([-points[:, 1], points[:, 0]], axis=1)
    assert np.abs(study_tracking.in_origin_datum(points, moved)).max() < 1e-18
    stretched = moved + 1e-5 * points
    assert study_tracking.in_origin_datum(points, stretched)[2] == pytest.approx([1e-6, 1e-6])
