# SPDX-License-Identifier: Apache-2.0
"""Every flaw by its id, and those in no catalogue: what a diagnosis must call unexplained."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, unit_vectors
from machine_tool_calibration.errors import CalibrationError, did_you_mean
from machine_tool_calibration.simulation.flaw import (
    BEAM,
    LINEAR,
    STATIONS,
    Chosen,
    Disturbance,
    Flaw,
    Parameters,
    Sight,
    drawn_phase,
    drawn_seed,
    reads,
)
from machine_tool_calibration.simulation.flaws_position import POSITION_FLAWS, REVERSAL_FLAWS, THERMAL_FLAWS
from machine_tool_calibration.simulation.scene import Scene

HELIUM_NEON = 0.6329908
"""Vacuum wavelength of the helium-neon laser, micrometres."""

STANDARD = (20.0, 101325.0, 0.5)
"""Standard air: °C, Pa, relative humidity."""


def vapour_pressure(temperature: Array | float, humidity: Array | float) -> Array:
    """Partial pressure of water vapour, Pa, in air at a temperature in °C and a relative humidity of 0 … 1."""
    kelvin = np.asarray(temperature, float) + 273.15
    exponent = 1.2378847e-5 * kelvin**2 - 1.9121316e-2 * kelvin + 33.93711047 - 6.3431645e3 / kelvin
    return np.asarray(np.exp(exponent) * humidity)


def refractivity(temperature: Array | float, pressure: Array | float, humidity: Array | float = 0.0) -> Array:
    """Refractive index of air minus one (He-Ne laser, 450 ppm CO2) at °C, Pa and relative humidity 0 (dry) … 1."""
    t, p = np.asarray(temperature, float), np.asarray(pressure, float)
    s = HELIUM_NEON**-2
    dispersion = 1e-8 * (8342.54 + 2406147.0 / (130.0 - s) + 15998.0 / (38.9 - s))
    dry = dispersion * p / 96095.43 * (1.0 + 1e-8 * (0.601 - 0.00972 * t) * p) / (1.0 + 0.0036610 * t)
    vapour = vapour_pressure(t, humidity) * 292.75 / (t + 273.15)
    return np.asarray(dry - vapour * (3.7345 - 0.0401 * s) * 1e-10)


def _air(scene: Scene) -> Array:
    """Refractive index of the air minus that of standard air (updated Edlén equation)."""
    sensed = (scene.sensed(name) for name in ("temperature_air", "air_pressure", "relative_humidity"))
    return refractivity(*sensed) - refractivity(*STANDARD)


def _by_setup(seed: int, setup: IntArray, draw: Callable[[np.random.Generator], Array]) -> Array:
    """Random vectors, each setup its own and the same whenever it is asked for."""
    table = {int(s): draw(np.random.default_rng([int(seed), int(s)])) for s in np.unique(setup)}
    return np.array([table[int(s)] for s in setup])


def _station_drift(size: float, given: Parameters, scene: Scene) -> Disturbance:
    """Each station's stand settles in its own direction at about `size` per second."""

    def velocity(rng: np.random.Generator) -> Array:
        way = rng.normal(size=3) * np.array([1.0, 1.0, given["vertical"]])
        return np.asarray(way / np.linalg.norm(way) * rng.uniform(0.5, 1.5))

    moved = _by_setup(given["seed"], scene.setup, velocity) * scene.since_setup()[:, None]
    return Disturbance(station=size * moved)


def _mirror(size: float, given: Parameters, scene: Scene) -> Disturbance:
    """The flat mirror is set up further off the beam, in each setup another way."""

    def tilt(rng: np.random.Generator) -> Array:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        return np.array([np.cos(angle), np.sin(angle)])

    return Disturbance(mirror=size * _by_setup(given["seed"], scene.setup, tilt))


def _harmonics(angle: Array, given: Parameters) -> Array:
    """Sum of w cos(k angle + phase) over the orders k."""
    waves = zip(given["orders"], given["weights"], given["phases"], strict=True)
    return sum((weight * np.cos(order * angle + phase) for order, weight, phase in waves), np.zeros(np.shape(angle)))


def _phases(rng: np.random.Generator, _: Scene | None) -> Parameters:
    return {"phases": [float(v) for v in rng.uniform(0, 2 * np.pi, 2)]}


def _level(sight: Sight) -> Array:
    """(n, 3) unit vectors of level beams of the same azimuth."""
    return unit_vectors(sight.azimuth, np.zeros_like(sight.azimuth))


def _pointer_radial(size: float, given: Parameters, _: Scene, sight: Sight) -> Array:
    """The rotation centre moves in the plane of azimuth as the pointer turns: against the beam, as seen from above."""
    back = size * _harmonics(sight.azimuth, given)
    return np.asarray(back * np.einsum("ni,ni->n", _level(sight), sight.direction))


def _pointer_axes(size: float, given: Parameters, _: Scene, sight: Sight) -> Array:
    """The elevation axis stands in front of the azimuth axis, and the beam leaves beside it.

    Of the triangle of axis, beam and target a beam that follows reads one leg; the distance is the hypotenuse.
    """
    line = sight.path[:, None] * sight.direction - size * _level(sight)
    square = np.einsum("ni,ni->n", line, line) - given["beam"] ** 2
    return np.asarray(np.sqrt(square) - sight.path)


def _table_growth(size: float, given: Parameters, scene: Scene) -> Disturbance:
    warm = scene.sensed("temperature_table") - given["reference"]
    return Disturbance(table_radial=size * warm, table_axial=size * given["axial"] * warm)


_AIR = "reading: size * (n - n of standard air)"
_SETTLES = "each station moves at about size, in its own direction, from its first reading on"
_TILTED = "mirror normal off the beam by size, each setup its own way"
_RADIAL = "rotation centre against the level beam: size * sum of w cos(k azimuth + phase)"
_AXES = "elevation axis in front of the azimuth axis by size, beam beside it by beam (m, where it follows the target)"
_INCIDENCE = "reading: size * sum of w cos(k incidence + phase)"
_NORMAL = "reading: size * sum of w cos(k direction of the normal + phase)"
_OUT = "targets move out by size * (temperature_table - 20) * radius, and up by axial times that of their height"
_WORK = "workpiece grows by size * (temperature_work - 20) about the table's centre"
_FIVE, _TWO = {"orders": [5, 3], "weights": [1.0, 0.5]}, {"orders": [2, 3], "weights": [1.0, 0.5]}
_THREE = {"orders": [2, 3], "weights": [1.0, 0.6]}
_COLD = {"reference": 20.0}

READING_FLAWS: tuple[Flaw, ...] = (
    # the wavelength is not compensated, or wrongly: this share of the air's deviation stays
    Flaw("refractive_index", f"{_AIR} * path", "1", 1.0,
         reads(lambda size, _, scene, sight: size * _air(scene) * sight.path), methods=BEAM),
    Flaw("dead_path", _AIR, "m", 1.0, reads(lambda size, _, scene, sight: size * _air(scene)), methods=BEAM),
    Flaw("linear_drift", "reading: size * time", "m/s", 1e-9, reads(lambda size, _, scene, sight: size * scene.time)),
    Flaw("station_drift", _SETTLES, "m/s", 1e-8, _station_drift, {"vertical": 1.0}, drawn_seed, STATIONS),
    Flaw("mirror_misalignment", _TILTED, "rad", 1e-3, _mirror, draw=drawn_seed, methods=("step_diagonal",)),
    Flaw("pointer_radial_error", _RADIAL, "m", 2e-6, reads(_pointer_radial), _FIVE, _phases, STATIONS),
    Flaw("pointer_zero_offset", "beam turned by size: cosine error", "rad", 2e-3,
         lambda size, _, scene: Disturbance(turn=np.full(len(scene), size)), methods=("tracking_interferometer",)),
    Flaw("pointer_axis_offset", _AXES, "m", 2e-5, reads(_pointer_axes), {"beam": 0.0}, methods=STATIONS),
    Flaw("retroreflector_form", _INCIDENCE, "m", 1e-6,
         reads(lambda size, given, _, sight: size * _harmonics(sight.incidence, given)), _TWO, _phases, STATIONS),
    Flaw("table_thermal_growth", _OUT, "1/K", 1.2e-5, _table_growth, {"axial": 1.0, **_COLD}, methods=("rotary_axis",)),
    Flaw("workpiece_thermal", _WORK, "1/K", 1.2e-5,
         lambda size, given, scene: Disturbance(growth=size * (scene.sensed("temperature_work") - given["reference"])),
         _COLD, methods=("probing", "direct")),
    # the stylus gives way, by direction, before the probe triggers
    Flaw("probe_pretravel", _NORMAL, "m", 3e-6,
         reads(lambda size, given, _, sight: size * _harmonics(sight.azimuth, given)), _THREE, _phases, ("probing",)),
)  # fmt: skip


def _moment(rng: np.random.Generator, scene: Scene | None) -> Parameters:
    if scene is None or len(scene) < 3:
        return {"moment": 600.0}
    return {"moment": float(scene.time[int(rng.uniform(0.3, 0.7) * len(scene))])}


def _product(size: float, _: Parameters, scene: Scene) -> Disturbance:
    """The structure twists: an error in all directions with the product x y, as no rigid body has."""
    x, y = (scene.along(axis) / np.abs(scene.ends.get(axis, (0.0, 1.0))).max() for axis in "XY")
    return Disturbance(point=size * (x * y)[:, None] * np.array([1.0, 1.0, 0.0]))


def _rate(size: float, given: Parameters, scene: Scene) -> Disturbance:
    """A gradient in the frame follows how fast the air's temperature changes, and saturates."""
    bent = np.tanh(scene.rate("temperature_air") / given["rate"])
    return Disturbance(point=size * bent[:, None] * np.array([1.0, -0.5, 0.5]))


def _hysteresis(size: float, given: Parameters, scene: Scene) -> Disturbance:
    """Lost motion in X that grows along Y, as a worn guideway has."""
    low, high = scene.ends.get("Y", (0.0, 1.0))
    worn = np.sin(np.pi * (scene.along("Y") - low) / (high - low))
    return Disturbance(axis={"X": -size * scene.toward("X") * worn * np.cos(given["turns"] * np.pi * worn)})


_PRODUCT = "position in x and y: size * x * y / (ends of travel)"
_RATE = "position: size * tanh(rate of the air's temperature / rate)"
_WAVE = "reading: size * sin(2 pi time / period + phase)"
_WORN = "position of X: lost motion that varies along y"
UNLISTED_FLAWS: tuple[Flaw, ...] = (
    # a counting error that grows with the cube of the change of path
    Flaw("unlisted_cubic_path", "reading: size * (change of path / scale)^3", "m", 4e-6,
         reads(lambda size, given, _, sight: size * (sight.change / given["scale"]) ** 3), {"scale": 0.3},
         methods=BEAM),
    # the instrument is knocked
    Flaw("unlisted_step", "reading: size from a moment on", "m", 3e-6,
         reads(lambda size, given, scene, _: np.where(scene.time >= given["moment"], size, 0.0)), draw=_moment),
    Flaw("unlisted_product", _PRODUCT, "m", 5e-6, _product, methods=LINEAR),
    Flaw("unlisted_rate", _RATE, "m", 5e-6, _rate, {"rate": 2e-4}, methods=(*LINEAR, "rotary_axis")),
    # an air conditioner that comes and goes
    Flaw("unlisted_wave", _WAVE, "m", 2e-6, reads(lambda size, given, scene, _: size * np.sin(
         2.0 * np.pi * scene.time / given["period"] + given["phase"])), {"period": 900.0}, drawn_phase),
    Flaw("unlisted_worn_guideway", _WORN, "m", 3e-6, _hysteresis, {"turns": 2.0}, methods=LINEAR),
)  # fmt: skip


FLAWS: Mapping[str, Flaw] = {
    flaw.id: flaw for flaw in (*POSITION_FLAWS, *REVERSAL_FLAWS, *THERMAL_FLAWS, *READING_FLAWS, *UNLISTED_FLAWS)
}


def find_flaw(name: str) -> Flaw:
    """The flaw of that id; if there is none, a CalibrationError names those that are alike."""
    if name in FLAWS:
        return FLAWS[name]
    hint = did_you_mean(name, FLAWS) or f"; known are {', '.join(FLAWS)}"
    raise CalibrationError(f"no effect {name!r} can be simulated{hint}")


def _is_like(value: Any, usual: Any) -> bool:
    """Whether a value is finite, and one number or several as the usual one is; any word in place of a word."""
    if isinstance(usual, str):
        return True
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        return False
    return numbers.ndim == np.ndim(usual) and bool(np.isfinite(numbers).all())


def choose_flaw(
    name: str,
    size: float | None = None,
    parameters: Mapping[str, Any] | None = None,
    seed: int | np.random.Generator = 0,
    scene: Scene | None = None,
) -> Chosen:
    """A flaw with its size and parameters; what is not given is typical, or drawn from the seed.

    The `scene` is the readings it is meant for, where that matters (`unlisted_step` happens among them). A
    CalibrationError if the effect or a parameter is unknown, or its value no number.
    """
    flaw = find_flaw(name)
    drawn = dict(flaw.draw(np.random.default_rng(seed), scene)) if flaw.draw else {}
    values = {**flaw.defaults, **drawn}
    for key, value in (parameters or {}).items():
        if key not in values:
            known = ", ".join(values) or "none"
            raise CalibrationError(f"effect {name} has no parameter {key!r}; its parameters are: {known}")
        if not _is_like(value, values[key]):
            kind = "finite numbers" if np.ndim(values[key]) else "a finite number"
            raise CalibrationError(f"effect {name}: {key} must be {kind}, not {value}")
        values[key] = value
    chosen = flaw.typical if size is None else float(size)
    if not np.isfinite(chosen):
        raise CalibrationError(f"effect {name}: the size must be a finite number")
    return Chosen(flaw, chosen, values)
