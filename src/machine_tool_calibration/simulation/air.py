"""Refractive index of air: the modified Edlén equation.

G. Bönsch and E. Potulski, "Measurement of the refractive index of air and comparison with modified Edlén's
formulae", Metrologia 35 (1998) 133-139, Eqs. (5a), (6a), (9a), for 400 ppm of carbon dioxide; the vapour
pressure from the relative humidity by the Magnus formula of the World Meteorological Organization (Guide to
instruments, WMO-No. 8, 2008, Annex 4.B).
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
    t = np.asarray(temperature, float)
    saturated: Array = 611.2 * np.exp(17.62 * t / (243.12 + t))
    return saturated * humidity


def refractivity(temperature: Array | float, pressure: Array | float, humidity: Array | float = 0.0) -> Array:
    """Refractive index of air minus one, for the helium-neon laser.

    Args:
        temperature: °C.
        pressure: Pa.
        humidity: relative, 0 (dry) … 1.
    """
    t, p = np.asarray(temperature, float), np.asarray(pressure, float)
    s = HELIUM_NEON**-2
    dispersion = 1e-8 * (8091.37 + 2333983.0 / (130.0 - s) + 15518.0 / (38.9 - s))
    dry = dispersion * p / 93214.60 * (1.0 + 1e-8 * (0.5953 - 0.009876 * t) * p) / (1.0 + 0.0036610 * t)
    moist: Array = dry - vapour_pressure(t, humidity) * (3.8020 - 0.0384 * s) * 1e-10
    return moist


def deviation(temperature: Array | float, pressure: Array | float, humidity: Array | float = 0.5) -> Array:
    """Refractive index minus that of standard air (20 °C, 101325 Pa, 50 %)."""
    excess: Array = refractivity(temperature, pressure, humidity) - refractivity(*STANDARD)
    return excess
