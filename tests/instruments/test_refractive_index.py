# SPDX-License-Identifier: Apache-2.0
"""The refractive index of air, against the other usual equation and a figure from tables."""

import numpy as np
import pytest

from machine_tool_calibration.instruments.refractive_index import STANDARD_AIR, index_deviation, refractivity
from machine_tool_calibration.simulation import flaws_reading as edlen

TEMPERATURE, PRESSURE, HUMIDITY = (
    grid.ravel() for grid in np.meshgrid([16.0, 20.0, 24.0], [9.4e4, 1.013e5, 1.04e5], [0.0, 0.4, 0.7])
)


def test_of_standard_air() -> None:
    # Ciddor's equation: 2.7137e-4 with 450 ppm of carbon dioxide.
    assert refractivity(*(np.array([v]) for v in STANDARD_AIR))[0] == pytest.approx(2.7137e-4, abs=3e-8)


def test_as_the_updated_equation_of_edlen_over_the_range_of_workshops() -> None:
    """Birch and Downs 1994, with 50 ppm more carbon dioxide, another dispersion, another law of the vapour."""
    found = refractivity(TEMPERATURE, PRESSURE, HUMIDITY)
    np.testing.assert_allclose(found, edlen.refractivity(TEMPERATURE, PRESSURE, HUMIDITY), atol=5e-8)
    found = index_deviation(TEMPERATURE, PRESSURE, HUMIDITY)
    np.testing.assert_allclose(found, edlen.deviation(TEMPERATURE, PRESSURE, HUMIDITY), atol=3e-8)


def test_what_was_not_recorded_is_standard_and_percent_are_known() -> None:
    standard = index_deviation(TEMPERATURE, np.full(27, 101325.0), np.full(27, 0.5))
    np.testing.assert_array_equal(index_deviation(TEMPERATURE, None, None), standard)
    in_percent = index_deviation(TEMPERATURE, PRESSURE, 100.0 * HUMIDITY)
    np.testing.assert_allclose(in_percent, index_deviation(TEMPERATURE, PRESSURE, HUMIDITY), rtol=1e-12)
    assert index_deviation(*(np.array([v]) for v in STANDARD_AIR))[0] == 0.0
