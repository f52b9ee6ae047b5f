"""Refractive index of air: the updated Edlén equation.

K. P. Birch and M. J. Downs, "Correction to the updated Edlén equation for the refractive index of air", Metrologia 31
(1994) 315-316, with the vapour term as a density (referred to 292.75 K, as NIST's Engineering Metrology Toolbox does)
and the saturation vapour pressure of the CIPM equation for moist air (R. S. Davis, Metrologia 29 (1992) 67-70).
"""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array

__all__ = ["STANDARD", "deviation", "refractivity", "vapour_pressure"]

HELIUM_NEON = 0.6329908
"""Vacuum wavelength of the helium-neon laser, micrometres."""

STANDARD = (20.0, 101325.0, 0.5)
"""Standard air: °C, Pa, relative humidity."""


def vapour_pressure(temperature: Array | float, humidity: Array | float) -> Array:
    """Partial pressure of water vapour, Pa, in air at a temperature in °C and a relative humidity of 0 … 1."""
    kelvin = np.asarray(temperature, float) + 273.15
    exponent = 1.2378847e-5 * kelvin**2 - 1.9121316e-2 * kelvin + 33.93711047 - 6.3431645e3 / kelvin
    saturated: Array = np.exp(exponent)
    return saturated * humidity


def refractivity(temperature: Array | float, pressure: Array | float, humidity: Array | float = 0.0) -> Array:
    """Refractive index of air minus one, for the helium-neon laser and 450 ppm of carbon dioxide.

    Args:
        temperature: °C.
        pressure: Pa.
        humidity: relative, 0 (dry) … 1.
    """
    t, p = np.asarray(temperature, float), np.asarray(pressure, float)
    s = HELIUM_NEON**-2
    dispersion = 1e-8 * (8342.54 + 2406147.0 / (130.0 - s) + 15998.0 / (38.9 - s))
    dry = dispersion * p / 96095.43 * (1.0 + 1e-8 * (0.601 - 0.00972 * t) * p) / (1.0 + 0.0036610 * t)
    vapour = vapour_pressure(t, humidity) * 292.75 / (t + 273.15)
    moist: Array = dry - vapour * (3.7345 - 0.0401 * s) * 1e-10
    return moist


def deviation(temperature: Array | float, pressure: Array | float, humidity: Array | float = 0.5) -> Array:
    """Refractive index minus that of standard air (20 °C, 101325 Pa, 50 %)."""
    excess: Array = refractivity(temperature, pressure, humidity) - refractivity(*STANDARD)
    return excess
