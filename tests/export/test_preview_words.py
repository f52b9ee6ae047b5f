# SPDX-License-Identifier: Apache-2.0
"""What is left after compensation is not less than it is uncertain by, and an axis that gets worse is named."""

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.export.compensation import Exported
from machine_tool_calibration.export.preview import ResidualErrors, summary
from machine_tool_calibration.reports.compensation import harm_words, left_table

POINTS = np.stack(np.meshgrid(*[np.linspace(0.0, 0.4, 4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
RNG = np.random.default_rng(5)
BEFORE = RNG.normal(0.0, 3e-6, POINTS.shape)


def exported(after: Array, u: float = 0.1e-6) -> Exported:
    errors = ResidualErrors(POINTS, BEFORE, after, np.full(POINTS.shape, u), np.ones(POINTS.shape, dtype=bool))
    return Exported({}, errors, summary(errors), [])


def test_tables_that_hold_the_whole_map_leave_its_uncertainty() -> None:
    found = exported(0.0 * BEFORE)
    assert [row.rms_left for row in found.left[:3]] == pytest.approx([0.1e-6] * 3)
    assert [row.largest_left for row in found.left[:3]] == pytest.approx([0.2e-6] * 3)
    rows = left_table(found).rows
    assert [row[2] for row in rows[:3]] == ["0.100"] * 3 and all(cell != "0" for row in rows for cell in row)
    assert not harm_words(found)


def test_an_axis_that_gets_worse_is_named() -> None:
    found = exported(BEFORE * [0.1, 0.1, 1.01])
    assert not found.worse
    before, after = (f"{1e6 * value:.2f} µm" for value in (found.left[2].rms_before, found.left[2].rms_after))
    assert harm_words(found) == f"the tables make Z ({before} → {after} RMS) worse; leave it out"
    assert "do not load" in harm_words(exported(2.0 * BEFORE))
