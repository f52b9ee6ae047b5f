# SPDX-License-Identifier: Apache-2.0
"""Sizes that occur: what is tried for is twice the limits of a coefficient."""

import pytest

from machine_tool_calibration.diagnosis.search.findings import Size
from machine_tool_calibration.effects.effect import Coefficient

WAVE = Coefficient("s", "m", -5e-5, 5e-5)


@pytest.mark.parametrize(
    ("value", "uncertainty", "plausible"),
    [
        (9e-6, 9e-6, True),
        (9e-5, 2e-5, True),
        (-9e-5, 1e-9, True),
        (1.1e-4, 1e-5, True),
        (-1.5e-4, 1e-5, False),
        # Intervals that reach into what occurs, and lie beyond it for the most part.
        (6.7e-4, 8.7e-4, False),
        (-1.6e-4, 1e-3, False),
        # Of several coefficients that go together none may be known well.
        (5e-5, 1e-4, True),
    ],
)
def test_a_wide_interval_makes_no_size_plausible(value: float, uncertainty: float, plausible: bool) -> None:
    assert Size(WAVE, value, uncertainty).plausible is plausible
