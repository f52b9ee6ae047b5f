# SPDX-License-Identifier: Apache-2.0
"""Flaws of the machine's position: backlash, reversals, heat, drifts, pitch errors, scale, and error motions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.simulation.disturbance import Disturbance
from machine_tool_calibration.simulation.flaw import Flaw, Parameters
from machine_tool_calibration.simulation.motions import (
    COMPONENTS,
    Table,
    constant,
    random_periodic,
    random_smooth,
    rotate,
)
from machine_tool_calibration.simulation.scene import Scene

__all__ = ["POSITION_FLAWS", "REVERSAL_FLAWS", "THERMAL_FLAWS"]

LINEAR = ("step_diagonal", "tracking_interferometer", "probing", "direct")
"""Methods that move linear axes."""


def _backlash(axis: str) -> Flaw:
    """The carriage lags behind its command by half the backlash, against the last move."""
    rotary = axis in "ABC"
    return Flaw(
        f"backlash_{axis.lower()}",
        f"position of {axis}: -size * dir_{axis.lower()} (half width)",
        "rad" if rotary else "m",
        1.3e-5 if rotary else 1.5e-6,
        lambda size, _, scene: Disturbance(axis={axis: -size * scene.toward(axis)}),
        methods=("rotary_axis", "probing") if axis == "C" else ("rotary_axis",) if rotary else LINEAR,
        axis=axis if rotary else "",
    )


def _thermal(axis: str, *, late: bool = False) -> Flaw:
    """The scale or screw of an axis grows with its temperature, away from where it is fixed.

    Where it is `late` it is a heavy bed behind the sensor on its surface.
    """
    column, behind = f"temperature_{axis.lower()}", " behind by tau" if late else ""

    def disturb(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
        sensed = scene.sensed_late(column, parameters["tau"]) if late else scene.sensed(column)
        excess = sensed - parameters["reference"]
        return Disturbance(axis={axis: size * excess * (scene.along(axis) - parameters["fixed_point"])})

    return Flaw(
        f"thermal_{'lag' if late else 'expansion'}_{axis.lower()}",
        f"position of {axis}: size * ({column}{behind} - 20) * ({axis.lower()} - fixed_point)",
        "1/K",
        1e-5 if late else 8e-6,
        disturb,
        {**({"tau": 1200.0} if late else {}), "reference": 20.0, "fixed_point": 0.0},
        methods=LINEAR,
    )


def _warmup(axis: str) -> Flaw:
    """The spindle or carriage moves off as the machine warms up, and settles."""
    return Flaw(
        f"warmup_{axis.lower()}",
        f"position of {axis}: size * (1 - exp(-time / tau))",
        "m",
        5e-6,
        lambda size, given, scene: Disturbance(axis={axis: size * (1.0 - np.exp(-scene.time / given["tau"]))}),
        draw=lambda rng, scene: {"tau": float(600.0 * 5.0 ** rng.uniform())},
        methods=LINEAR,
    )


def _pitch(axis: str) -> Flaw:
    """The screw's pitch or the encoder's grating repeats its error with every lead."""

    def disturb(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
        phase = 2.0 * np.pi * scene.along(axis) / parameters["lead"] + parameters["phase"]
        return Disturbance(axis={axis: size * np.sin(phase)})

    return Flaw(
        f"pitch_periodic_{axis.lower()}",
        f"position of {axis}: size * sin(2 pi {axis.lower()} / lead + phase)",
        "m",
        1.5e-6,
        disturb,
        {"lead": 0.012},
        lambda rng, scene: {"phase": float(rng.uniform(0, 2 * np.pi))},
        LINEAR,
    )


def _squareness(name: str) -> Flaw:
    def disturb(size: float, _: Parameters, scene: Scene) -> Disturbance:
        return Disturbance(squareness={name: size})

    return Flaw(name, f"squareness {name} = size", "rad", 1e-5, disturb, methods=LINEAR)


def shaped(name: str, size: float, parameters: Parameters, ends: Mapping[str, tuple[float, float]]) -> Table:
    """The table of an extra error motion: `shape` is random (by `seed`), constant, linear, quadratic or sine."""
    axis, shape = name[-1], parameters["shape"]
    if axis not in "XYZ":
        rng = np.random.default_rng(int(parameters["seed"]))
        return random_periodic(rng, [size])[0] if shape == "random" else constant(0.0, 2 * np.pi, size)
    low, high = ends.get(axis, (0.0, 1.0))
    if shape == "random":
        return random_smooth(np.random.default_rng(int(parameters["seed"])), low, high, [size], knots=5)[0]
    nodes = np.linspace(low, high, 33)
    u = 2.0 * (nodes - low) / (high - low) - 1.0
    shapes = {"constant": np.ones(33), "linear": u, "quadratic": u**2, "sine": np.sin(np.pi * u)}
    if shape not in shapes:
        raise CalibrationError(f"{name}: the shape {shape!r} is none of random, {', '.join(shapes)}")
    return Table(tuple(nodes), tuple(size * shapes[shape]), "cubic")


def _motion(name: str) -> Flaw:
    angular, axis = name[1] in "ABC", name[-1]

    def disturb(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
        table = shaped(name, size, parameters, scene.ends)
        if parameters.get("about", "chain") == "chain":
            return Disturbance(tables=((name, table),))
        if parameters["about"] != "zero":
            raise CalibrationError(f"{name}: about is {parameters['about']!r}, neither chain nor zero")
        arm = scene.position * (np.arange(3) != "XYZ".index(axis))
        turned = rotate(arm, table(scene.along(axis))[:, None] * np.eye(3)["ABC".index(name[1])])
        return Disturbance(point=turned - arm)

    def draw(rng: np.random.Generator, _: Scene | None) -> dict[str, Any]:
        return {"seed": int(rng.integers(2**31))}

    return Flaw(
        name,
        f"error motion {name} as a smooth function of {axis.lower()}, largest absolute value size"
        + (
            "; about: chain (rigid bodies) or zero (the carriage turns about the machine's zero)"
            if angular and axis != "C"
            else ""
        ),
        "rad" if angular else "m",
        2e-5 if angular else 3e-6,
        disturb,
        {"shape": "random", "about": "chain"} if angular and axis != "C" else {"shape": "random"},
        draw,
        ("rotary_axis", "probing") if axis == "C" else LINEAR,
        axis if axis == "C" else "",
    )


POSITION_FLAWS: tuple[Flaw, ...] = (
    *(_backlash(axis) for axis in "XYZABC"),
    *(make(axis) for make in (_thermal, _warmup, _pitch) for axis in "XYZ"),
    Flaw(
        "scale",
        "position: size * (x, y, z)",
        "1",
        1e-5,
        lambda size, _, scene: Disturbance(axis={axis: size * scene.along(axis) for axis in "XYZ"}),
        methods=LINEAR,
    ),
    *(_squareness(name) for name in ("A0Z", "B0Z", "C0Y")),
    *(_motion(component + axis) for axis in "XYZC" for component in COMPONENTS),
)


def _lost_motion(axis: str) -> Flaw:
    """A screw that is worn most at one place: the nut has most play there, and half of it half a travel away."""

    def disturb(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
        low, high = scene.ends.get(axis, (0.0, 1.0))
        away = (scene.along(axis) - low) / (high - low) - parameters["where"]
        play = size * np.cos(0.5 * np.pi * away) ** 2
        return Disturbance(axis={axis: -play * scene.toward(axis)})

    return Flaw(
        f"lost_motion_{axis.lower()}",
        f"position of {axis}: half the play against dir_{axis.lower()}, size at the share `where` of the travel, "
        "half of it half a travel away",
        "m",
        2e-6,
        disturb,
        {"where": 0.2},
        methods=LINEAR,
    )


def _reversal(name: str) -> Flaw:
    """The carriage lies against the other side of its guideway when it comes back: shifted or turned as a body."""
    axis, component = name[-1], COMPONENTS.index(name[:2])

    def disturb(size: float, _: Parameters, scene: Scene) -> Disturbance:
        errors = np.zeros((len(scene), 6))
        errors[:, component] = -size * scene.toward(axis)
        return Disturbance(errors={axis: errors})

    angular = name[1] in "ABC"
    return Flaw(
        f"reversal_{name}",
        f"error motion {name}: -size * dir_{axis.lower()} (half width)",
        "rad" if angular else "m",
        8e-6 if angular else 1.5e-6,
        disturb,
        methods=LINEAR,
    )


REVERSAL_FLAWS: tuple[Flaw, ...] = (
    *(_lost_motion(axis) for axis in "XYZ"),
    *(_reversal(component + axis) for axis in "XYZ" for component in COMPONENTS if component[1] != axis),
)

_AXES = {"C0Y": "XY", "B0Z": "XZ", "A0Z": "YZ"}


def _turned_way(name: str, angle: Array, scene: Scene) -> Disturbance:
    """An axis whose way is turned by an angle in each reading, (n,) rad: what it has travelled points elsewhere."""
    way = scene.along(name[2])[:, None] * np.eye(3)["XYZ".index(name[2])]
    return Disturbance(point=rotate(way, angle[:, None] * np.eye(3)["ABC".index(name[0])]) - way)


def _squareness_drift(name: str) -> Flaw:
    def disturb(size: float, _: Parameters, scene: Scene) -> Disturbance:
        return _turned_way(name, size * scene.time, scene)

    return Flaw(f"squareness_drift_{name}", f"squareness {name} = size * time", "rad/s", 5e-9, disturb, methods=LINEAR)


def _squareness_thermal(name: str) -> Flaw:
    columns = [f"temperature_{axis.lower()}" for axis in _AXES[name]]

    def disturb(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
        warm = 0.5 * (scene.sensed(columns[0]) + scene.sensed(columns[1])) - parameters["reference"]
        return _turned_way(name, size * warm, scene)

    return Flaw(
        f"squareness_thermal_{name}",
        f"squareness {name} = size * (mean of {' and '.join(columns)} - 20)",
        "rad/K",
        1e-5,
        disturb,
        {"reference": 20.0},
        methods=LINEAR,
    )


def _rotary_drift(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
    """The table's foundation settles: its axis moves in a direction of its own, and tilts."""
    way = np.asarray(parameters["direction"], float)
    tilt = parameters["tilt"] * np.cross(np.eye(3)["ABC".index(scene.axis)], way)
    moved = size * scene.time[:, None]
    return Disturbance(table_shift=moved * way, table_tilt=moved * tilt)


def _direction(rng: np.random.Generator, _: Scene | None) -> dict[str, list[float]]:
    way = rng.normal(size=3)
    return {"direction": [float(v) for v in way / np.linalg.norm(way)]}


THERMAL_FLAWS: tuple[Flaw, ...] = (
    *(_squareness_drift(name) for name in _AXES),
    *(_squareness_thermal(name) for name in _AXES),
    *(_thermal(axis, late=True) for axis in "XYZ"),
    Flaw(
        "rotary_axis_drift",
        "axis of the table moves by size * time along direction, and tilts by tilt (rad/m) of it",
        "m/s",
        2e-9,
        _rotary_drift,
        {"tilt": 3.0},
        _direction,
        ("rotary_axis", "probing"),
    ),
)
