# SPDX-License-Identifier: Apache-2.0
"""Flaws of the instrument, of its place, and of the part: air, dead path, drift, pointer, retroreflector, probe."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.simulation.disturbance import Disturbance, Sight
from machine_tool_calibration.simulation.flaw import Flaw, Parameters
from machine_tool_calibration.simulation.scene import Scene
from machine_tool_calibration.simulation.sensors import beam_direction

__all__ = ["READING_FLAWS", "STANDARD", "deviation", "refractivity", "vapour_pressure"]

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


LASERS = ("step_diagonal", "tracking_interferometer", "rotary_axis")
STATIONS = ("tracking_interferometer", "rotary_axis")


def _air(scene: Scene) -> Array:
    """Refractive index of the air minus that of standard air (updated Edlén equation)."""
    return deviation(scene.sensed("temperature_air"), scene.sensed("air_pressure"), scene.sensed("relative_humidity"))


def _by_setup(seed: int, setup: IntArray, draw: Any) -> Array:
    """Random vectors, each setup its own and the same whenever it is asked for."""
    table: Mapping[int, Array] = {int(s): draw(np.random.default_rng([int(seed), int(s)])) for s in np.unique(setup)}
    return np.array([table[int(s)] for s in setup])


def _station_drift(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
    """Each station's stand settles in its own direction at about `size` per second."""

    def velocity(rng: np.random.Generator) -> Array:
        way = rng.normal(size=3) * np.array([1.0, 1.0, parameters["vertical"]])
        return np.asarray(way / np.linalg.norm(way) * rng.uniform(0.5, 1.5))

    moved = _by_setup(parameters["seed"], scene.setup, velocity) * scene.since_setup()[:, None]
    return Disturbance(station=size * moved)


def _mirror(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
    """The flat mirror is set up further off the beam, in each setup another way."""

    def tilt(rng: np.random.Generator) -> Array:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        return np.array([np.cos(angle), np.sin(angle)])

    return Disturbance(mirror=size * _by_setup(parameters["seed"], scene.setup, tilt))


def _harmonics(angle: Array, parameters: Parameters) -> Array:
    """Sum of w cos(k angle + phase) over the orders k."""
    total = np.zeros(np.shape(angle))
    for order, weight, phase in zip(parameters["orders"], parameters["weights"], parameters["phases"], strict=True):
        total = total + weight * np.cos(order * angle + phase)
    return total


def _phases(rng: np.random.Generator, _: Scene | None) -> dict[str, Any]:
    return {"phases": [float(v) for v in rng.uniform(0, 2 * np.pi, 2)]}


def _seed(rng: np.random.Generator, _: Scene | None) -> dict[str, Any]:
    return {"seed": int(rng.integers(2**31))}


def _level(sight: Sight) -> Array:
    """(n, 3) unit vectors of level beams of the same azimuth."""
    return beam_direction(sight.azimuth, np.zeros_like(sight.azimuth))


def _pointer_radial(size: float, parameters: Parameters, _: Scene) -> Disturbance:
    """The rotation centre moves in the plane of azimuth as the pointer turns: against the beam, as seen from above."""

    def along(sight: Sight) -> Array:
        back = size * _harmonics(sight.azimuth, parameters)
        return np.asarray(back * np.einsum("ni,ni->n", _level(sight), sight.direction))

    return Disturbance(reading=(along,))


def _pointer_axes(size: float, parameters: Parameters, _: Scene) -> Disturbance:
    """The elevation axis stands in front of the azimuth axis, and the beam leaves beside it.

    Of the triangle of axis, beam and target a beam that follows reads one leg; the distance is the hypotenuse.
    """

    def path(sight: Sight) -> Array:
        line = sight.path[:, None] * sight.direction - size * _level(sight)
        square = np.einsum("ni,ni->n", line, line) - parameters["beam"] ** 2
        return np.asarray(np.sqrt(square) - sight.path)

    return Disturbance(reading=(path,))


def _table_growth(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
    warm = scene.sensed("temperature_table") - parameters["reference"]
    return Disturbance(table_radial=size * warm, table_axial=size * parameters["axial"] * warm)


READING_FLAWS: tuple[Flaw, ...] = (
    Flaw(
        "refractive_index",  # the wavelength is not compensated, or wrongly: this share of the air's deviation stays
        "reading: size * (n - n of standard air) * path",
        "1",
        1.0,
        lambda size, _, scene: Disturbance(optical=size * _air(scene)),
        methods=LASERS,
    ),
    Flaw(
        "dead_path",
        "reading: size * (n - n of standard air)",
        "m",
        1.0,
        lambda size, _, scene: Disturbance(dead=size * _air(scene)),
        methods=LASERS,
    ),
    Flaw(
        "linear_drift",
        "reading: size * time",
        "m/s",
        1e-9,
        lambda size, _, scene: Disturbance(reading=(lambda sight: size * scene.time,)),
    ),
    Flaw(
        "station_drift",
        "each station moves at about size, in its own direction, from its first reading on",
        "m/s",
        1e-8,
        _station_drift,
        {"vertical": 1.0},
        _seed,
        STATIONS,
    ),
    Flaw(
        "mirror_misalignment",
        "mirror normal off the beam by size, each setup its own way",
        "rad",
        1e-3,
        _mirror,
        draw=_seed,
        methods=("step_diagonal",),
    ),
    Flaw(
        "pointer_radial_error",
        "rotation centre against the level beam: size * sum of w cos(k azimuth + phase)",
        "m",
        2e-6,
        _pointer_radial,
        {"orders": [5, 3], "weights": [1.0, 0.5]},
        _phases,
        STATIONS,
    ),
    Flaw(
        "pointer_zero_offset",
        "beam turned by size: cosine error",
        "rad",
        2e-3,
        lambda size, _, scene: Disturbance(turn=np.full(len(scene), size)),
        methods=("tracking_interferometer",),
    ),
    Flaw(
        "pointer_axis_offset",
        "elevation axis in front of the azimuth axis by size, beam beside it by beam (m, where it follows the target)",
        "m",
        2e-5,
        _pointer_axes,
        {"beam": 0.0},
        methods=STATIONS,
    ),
    Flaw(
        "retroreflector_form",
        "reading: size * sum of w cos(k incidence + phase)",
        "m",
        1e-6,
        lambda size, given, _: Disturbance(reading=(lambda sight: size * _harmonics(sight.incidence, given),)),
        {"orders": [2, 3], "weights": [1.0, 0.5]},
        _phases,
        STATIONS,
    ),
    Flaw(
        "table_thermal_growth",
        "targets move out by size * (temperature_table - 20) * radius, and up by axial times that of their height",
        "1/K",
        1.2e-5,
        _table_growth,
        {"axial": 1.0, "reference": 20.0},
        methods=("rotary_axis",),
    ),
    Flaw(
        "workpiece_thermal",
        "workpiece grows by size * (temperature_work - 20) about the table's centre",
        "1/K",
        1.2e-5,
        lambda size, given, scene: Disturbance(growth=size * (scene.sensed("temperature_work") - given["reference"])),
        {"reference": 20.0},
        methods=("probing", "direct"),
    ),
    Flaw(
        "probe_pretravel",  # the stylus gives way, by direction, before the probe triggers
        "reading: size * sum of w cos(k direction of the normal + phase)",
        "m",
        3e-6,
        lambda size, given, _: Disturbance(reading=(lambda sight: size * _harmonics(sight.azimuth, given),)),
        {"orders": [2, 3], "weights": [1.0, 0.6]},
        _phases,
        ("probing",),
    ),
)
