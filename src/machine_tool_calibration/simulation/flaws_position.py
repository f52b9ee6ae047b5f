# SPDX-License-Identifier: Apache-2.0
"""Flaws of the machine's position: backlash, reversals, heat, drifts, pitch errors, scale, and error motions."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.simulation import motions
from machine_tool_calibration.simulation.flaw import (
    CIRCLE,
    LINEAR,
    TABLE,
    Disturbance,
    Draw,
    Flaw,
    Parameters,
    drawn_phase,
    drawn_seed,
)
from machine_tool_calibration.simulation.scene import Scene

_ABOUT = "; about: chain (rigid bodies) or zero (the carriage turns about the machine's zero)"
_COLD: Parameters = {"reference": 20.0}

Along = Callable[[float, Parameters, Scene, str], Array]
"""How far the carriage of an axis is ahead of its command, from size, parameters, scene and axis, m or rad."""


def _along(
    name: str, formula: str, typical: float, shift: Along, given: Parameters | None = None, draw: Draw | None = None,
    *, axes: str = "XYZ", unit: str = "m", methods: tuple[str, ...] = LINEAR,
) -> Iterator[Flaw]:  # fmt: skip
    """Flaws of axes along their own motion; in the formula `{a}` stands for the axis."""
    for axis in axes:

        def disturb(size: float, given: Parameters, scene: Scene, axis: str = axis) -> Disturbance:
            return Disturbance(axis={axis: shift(size, given, scene, axis)})

        text = f"position of {axis}: " + formula.format(a=axis.lower())
        only = axis if axis in "ABC" else ""
        yield Flaw(f"{name}_{axis.lower()}", text, unit, typical, disturb, given or {}, draw, methods, only)


def _backlash(size: float, _: Parameters, scene: Scene, axis: str) -> Array:
    """The carriage lags behind its command by half the backlash, against the last move."""
    return np.asarray(-size * scene.toward(axis))


def _expansion(size: float, given: Parameters, scene: Scene, axis: str) -> Array:
    """The scale or screw grows with its temperature, away from where it is fixed; a heavy bed behind its sensor."""
    column = f"temperature_{axis.lower()}"
    sensed = scene.sensed(column, given.get("tau", 0.0))
    return np.asarray(size * (sensed - given["reference"]) * (scene.along(axis) - given["fixed_point"]))


def _warmup(size: float, given: Parameters, scene: Scene, _: str) -> Array:
    """The spindle or carriage moves off as the machine warms up, and settles."""
    return np.asarray(size * (1.0 - np.exp(-scene.time / given["tau"])))


def _screw_growth(size: float, given: Parameters, scene: Scene, axis: str) -> Array:
    """A screw that warms up pushes what it carries away from its fixed bearing, the farther off the more."""
    return np.asarray((scene.along(axis) - given["fixed_point"]) * _warmup(size, given, scene, axis))


def _pitch(size: float, given: Parameters, scene: Scene, axis: str) -> Array:
    """The screw's pitch or the encoder's grating repeats its error with every lead."""
    return np.asarray(size * np.sin(2.0 * np.pi * scene.along(axis) / given["lead"] + given["phase"]))


def _cogging(size: float, given: Parameters, scene: Scene, axis: str) -> Array:
    """A motor's poles pull what friction holds: forward on one way, back on the other."""
    return np.asarray(_pitch(size, given, scene, axis) * scene.toward(axis))


def _lost_motion(size: float, given: Parameters, scene: Scene, axis: str) -> Array:
    """A screw that is worn most at one place: the nut has most play there, and half of it half a travel away."""
    low, high = scene.ends.get(axis, (0.0, 1.0))
    away = (scene.along(axis) - low) / (high - low) - given["where"]
    play = size * np.cos(0.5 * np.pi * away) ** 2
    return np.asarray(-play * scene.toward(axis))


def _warmup_time(rng: np.random.Generator, _: Scene | None) -> dict[str, Any]:
    return {"tau": float(600.0 * 5.0 ** rng.uniform())}


def _servo_lag(size: float, _: Parameters, scene: Scene, axis: str) -> Array:
    """The carriage follows its command late; what both axes of a plane have in common shows in no radius."""
    return np.asarray(-size * scene.velocity.get(axis, np.zeros(len(scene))))


def _spike(size: float, given: Parameters, scene: Scene, axis: str) -> Array:
    """Friction holds the carriage back as it reverses."""
    since = scene.since_reversal.get(axis, np.full(len(scene), np.inf))
    return np.asarray(-size * scene.toward(axis) * np.exp(-since / given["reach"]))


def _vibration(size: float, given: Parameters, scene: Scene, _: str) -> Array:
    """Something near the machine, or a loop of its own, shakes the carriage."""
    return np.asarray(size * np.sin(2.0 * np.pi * given["frequency"] * scene.time + given["phase"]))


def _squareness(name: str) -> Flaw:
    text = f"squareness {name} = size"
    return Flaw(name, text, "rad", 1e-5, lambda size, _, scene: Disturbance(squareness={name: size}), methods=LINEAR)


def shaped(name: str, size: float, parameters: Parameters, ends: Mapping[str, tuple[float, float]]) -> motions.Table:
    """The table of an extra error motion: `shape` is random (by `seed`), constant, linear, quadratic or sine."""
    axis, shape = name[-1], parameters["shape"]
    if axis not in "XYZ":
        if shape != "random":
            return motions.Table((0.0, 2 * np.pi), (size, size), "linear")
        return motions.random_periodic(np.random.default_rng(int(parameters["seed"])), [size])[0]
    low, high = ends.get(axis, (0.0, 1.0))
    if shape == "random":
        return motions.random_smooth(np.random.default_rng(int(parameters["seed"])), low, high, [size], knots=5)[0]
    nodes = np.linspace(low, high, 33)
    u = 2.0 * (nodes - low) / (high - low) - 1.0
    shapes = {"constant": np.ones(33), "linear": u, "quadratic": u**2, "sine": np.sin(np.pi * u)}
    if shape not in shapes:
        raise CalibrationError(f"{name}: the shape {shape!r} is none of random, {', '.join(shapes)}")
    return motions.Table(tuple(nodes), tuple(size * shapes[shape]), "cubic")


def _motion(name: str) -> Flaw:
    angular, axis = name[1] in "ABC", name[-1]
    is_table = axis == "C"

    def disturb(size: float, given: Parameters, scene: Scene) -> Disturbance:
        table = shaped(name, size, given, scene.ends)
        if given.get("about", "chain") == "chain":
            return Disturbance(tables=((name, table),))
        if given["about"] != "zero":
            raise CalibrationError(f"{name}: about is {given['about']!r}, neither chain nor zero")
        arm = scene.position * (np.arange(3) != "XYZ".index(axis))
        turned = motions.rotate(arm, table(scene.along(axis))[:, None] * np.eye(3)["ABC".index(name[1])])
        return Disturbance(point=turned - arm)

    yields = angular and not is_table
    return Flaw(
        name,
        f"error motion {name} as a smooth function of {axis.lower()}, largest absolute value size" + _ABOUT * yields,
        "rad" if angular else "m",
        2e-5 if angular else 3e-6,
        disturb,
        {"shape": "random", **({"about": "chain"} if yields else {})},
        drawn_seed,
        TABLE if is_table else LINEAR,
        axis if is_table else "",
    )


def _carriage(
    flaw: str, name: str, formula: str, shift: Along, given: Parameters | None = None, draw: Draw | None = None,
    *, methods: tuple[str, ...] = LINEAR,
) -> Flaw:  # fmt: skip
    """A flaw of an axis that moves its carriage as a body, by one error motion: shifted or turned."""
    axis, component = name[-1], motions.COMPONENTS.index(name[:2])

    def disturb(size: float, given: Parameters, scene: Scene) -> Disturbance:
        errors = np.zeros((len(scene), 6))
        errors[:, component] = shift(size, given, scene, axis)
        return Disturbance(errors={axis: errors})

    unit, typical = ("rad", 8e-6) if name[1] in "ABC" else ("m", 1.5e-6)
    text = f"error motion {name}: " + formula.format(a=axis.lower())
    return Flaw(f"{flaw}_{name}", text, unit, typical, disturb, given or {}, draw, methods)


def _aside(components: Sequence[str]) -> list[str]:
    """Error motions of a linear axis that are not along it."""
    return [component + axis for axis in "XYZ" for component in components if component[1] != axis]


_HALF_WIDTH = "-size * dir_{a} (half width)"
_EXPANDS = "size * (temperature_{a} - 20) * ({a} - fixed_point)"
_GROWS = "size * ({a} - fixed_point) * (1 - exp(-time / tau))"
_SHAKES = "size * sin(2 pi frequency time + phase)"
_WAVES = "size * sin(2 pi {a} / lead + phase)"
POSITION_FLAWS: tuple[Flaw, ...] = (
    *_along("backlash", _HALF_WIDTH, 1.5e-6, _backlash),
    *_along("backlash", _HALF_WIDTH, 1.3e-5, _backlash, axes="AB", unit="rad", methods=TABLE[:1]),
    *_along("backlash", _HALF_WIDTH, 1.3e-5, _backlash, axes="C", unit="rad", methods=TABLE),
    *_along("thermal_expansion", _EXPANDS, 8e-6, _expansion, {**_COLD, "fixed_point": 0.0}, unit="1/K"),
    *_along("warmup", "size * (1 - exp(-time / tau))", 5e-6, _warmup, draw=_warmup_time),
    *_along("screw_growth", _GROWS, 2e-5, _screw_growth, {"fixed_point": 0.0}, _warmup_time, unit="1"),
    *_along("pitch_periodic", _WAVES, 1.5e-6, _pitch, {"lead": 0.012}, drawn_phase),
    *_along("reversal_periodic", f"dir_{{a}} * {_WAVES}", 1.5e-6, _cogging, {"lead": 0.012}, drawn_phase),
    # a screw that is not straight moves the carriage aside once a lead
    *(_carriage("straightness_periodic", name, _WAVES, _pitch, {"lead": 0.012}, drawn_phase, methods=CIRCLE)
      for name in _aside(motions.COMPONENTS[:3])),
    Flaw("scale", "position: size * (x, y, z)", "1", 1e-5,
         lambda size, _, scene: Disturbance(axis={axis: size * scene.along(axis) for axis in "XYZ"}), methods=LINEAR),
    *(_squareness(name) for name in ("A0Z", "B0Z", "C0Y")),
    *(_motion(component + axis) for axis in "XYZC" for component in motions.COMPONENTS),
)  # fmt: skip


_SPIKES = "-size * dir_{a} * exp(-path since {a} reversed / reach)"
_WORN = "half the play against dir_{a}, size at the share `where` of the travel, half of it half a travel away"
REVERSAL_FLAWS: tuple[Flaw, ...] = (
    *_along("lost_motion", _WORN, 2e-6, _lost_motion, {"where": 0.2}),
    *_along("reversal_spike", _SPIKES, 2e-6, _spike, {"reach": 0.005}, methods=CIRCLE),
    *_along("servo_mismatch", "-size * velocity of {a}", 1e-4, _servo_lag, unit="s", methods=CIRCLE),
    *_along("vibration", _SHAKES, 1e-6, _vibration, {"frequency": 0.37}, drawn_phase, methods=CIRCLE),
    # the carriage lies against the other side of its guideway when it comes back
    *(_carriage("reversal", name, _HALF_WIDTH, _backlash) for name in _aside(motions.COMPONENTS)),
)

_AXES = {"C0Y": "XY", "B0Z": "XZ", "A0Z": "YZ"}


def _turned_way(name: str, angle: Array, scene: Scene) -> Disturbance:
    """An axis whose way is turned by an angle in each reading, (n,) rad: what it has travelled points elsewhere."""
    way = scene.along(name[2])[:, None] * np.eye(3)["XYZ".index(name[2])]
    return Disturbance(point=motions.rotate(way, angle[:, None] * np.eye(3)["ABC".index(name[0])]) - way)


def _squareness_drift(name: str) -> Flaw:
    return Flaw(f"squareness_drift_{name}", f"squareness {name} = size * time", "rad/s", 5e-9,
                lambda size, _, scene: _turned_way(name, size * scene.time, scene), methods=LINEAR)  # fmt: skip


def _squareness_thermal(name: str) -> Flaw:
    first, second = (f"temperature_{axis.lower()}" for axis in _AXES[name])

    def disturb(size: float, given: Parameters, scene: Scene) -> Disturbance:
        warm = 0.5 * (scene.sensed(first) + scene.sensed(second)) - given["reference"]
        return _turned_way(name, size * warm, scene)

    text = f"squareness {name} = size * (mean of {first} and {second} - 20)"
    return Flaw(f"squareness_thermal_{name}", text, "rad/K", 1e-5, disturb, _COLD, methods=LINEAR)


def _rotary_drift(size: float, given: Parameters, scene: Scene) -> Disturbance:
    """The table's foundation settles: its axis moves in a direction of its own, and tilts."""
    way = np.asarray(given["direction"], float)
    tilt = given["tilt"] * np.cross(np.eye(3)["ABC".index(scene.axis)], way)
    moved = size * scene.time[:, None]
    return Disturbance(table_shift=moved * way, table_tilt=moved * tilt)


def _direction(rng: np.random.Generator, _: Scene | None) -> dict[str, Any]:
    way = rng.normal(size=3)
    return {"direction": [float(v) for v in way / np.linalg.norm(way)]}


_LATE = "size * (temperature_{a} behind by tau - 20) * ({a} - fixed_point)"
_SETTLES = "axis of the table moves by size * time along direction, and tilts by tilt (rad/m) of it"
THERMAL_FLAWS: tuple[Flaw, ...] = (
    *(_squareness_drift(name) for name in _AXES),
    *(_squareness_thermal(name) for name in _AXES),
    *_along("thermal_lag", _LATE, 1e-5, _expansion, {"tau": 1200.0, **_COLD, "fixed_point": 0.0}, unit="1/K"),
    Flaw("rotary_axis_drift", _SETTLES, "m/s", 2e-9, _rotary_drift, {"tilt": 3.0}, _direction, TABLE),
)
