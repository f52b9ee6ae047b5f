# SPDX-License-Identifier: Apache-2.0
"""The papers' figures that come out the same, and those that cannot."""

from __future__ import annotations

import pytest

from machine_tool_calibration.validation import study_step_diagonal
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
