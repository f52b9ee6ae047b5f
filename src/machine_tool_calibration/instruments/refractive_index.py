# SPDX-License-Identifier: Apache-2.0
"""Refractive index of air."""

import numpy as np

from machine_tool_calibration.arrays import Array

STANDARD_AIR = (20.0, 101325.0, 0.5)
"""Temperature in degrees Celsius, pressure in Pa, relative humidity from 0 to 1."""


def refractivity(temperature: Array, pressure: Array, humidity: Array) -> Array:
    """(n,) index minus one of air for the He-Ne line (633 nm), at degrees Celsius, Pa and relative humidity (0 to 1).

    Edlén's equation in the form of Bönsch and Potulski, Metrologia 35 (1998) 133, with 400 ppm of carbon dioxide (Eqs.
    (6a) and (9)), and the Magnus formula for the vapour pressure over water.
    """
    wave_number_squared = (1.0 / 0.6329914) ** 2
    standard = 1e-8 * (8091.37 + 2333983.0 / (130.0 - wave_number_squared) + 15518.0 / (38.9 - wave_number_squared))
    dry = standard * pressure / 93214.6 * (1.0 + 1e-8 * (0.5953 - 0.009876 * temperature) * pressure)
    dry = dry / (1.0 + 0.0036610 * temperature)
    vapour = humidity * 611.2 * np.exp(17.62 * temperature / (243.12 + temperature))
    return np.asarray(dry - vapour * (3.8020 - 0.0384 * wave_number_squared) * 1e-10)


def index_deviation(temperature: Array, pressure: Array | None, humidity: Array | None) -> Array:
    """(n,) index of the air minus that of standard air; what was not recorded is taken as standard."""
    air_pressure = np.full_like(temperature, STANDARD_AIR[1]) if pressure is None else pressure
    relative = np.full_like(temperature, STANDARD_AIR[2]) if humidity is None else humidity
    standard = refractivity(*(np.array([value]) for value in STANDARD_AIR))[0]
    return np.asarray(refractivity(temperature, air_pressure, relative) - standard)
