# SPDX-License-Identifier: Apache-2.0
"""Flaws in no catalogue: what a diagnosis must call unexplained."""

from __future__ import annotations

from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.simulation.disturbance import Disturbance, Sight
from machine_tool_calibration.simulation.flaw import Flaw, Parameters
from machine_tool_calibration.simulation.scene import Scene

__all__ = ["UNLISTED_FLAWS"]

INTERFEROMETERS = ("step_diagonal", "tracking_interferometer", "rotary_axis")
POSITIONS = ("step_diagonal", "tracking_interferometer", "probing", "direct")


def _cubic(size: float, parameters: Parameters, _: Scene) -> Disturbance:
    """A counting error that grows with the cube of the change of path."""

    def cube(sight: Sight) -> Array:
        return np.asarray(size * (sight.change / parameters["scale"]) ** 3)

    return Disturbance(reading=(cube,))


def _step(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
    """The instrument is knocked: all later readings are off by `size`."""
    after = np.where(scene.time >= parameters["moment"], size, 0.0)
    return Disturbance(reading=(lambda sight: after,))


def _moment(rng: np.random.Generator, scene: Scene | None) -> dict[str, Any]:
    if scene is None or len(scene) < 3:
        return {"moment": 600.0}
    return {"moment": float(scene.time[int(rng.uniform(0.3, 0.7) * len(scene))])}


def _product(size: float, _: Parameters, scene: Scene) -> Disturbance:
    """The structure twists: an error in all directions with the product x y, as no rigid body has."""
    shape = np.ones(len(scene))
    for axis in "XY":
        low, high = scene.ends.get(axis, (0.0, 1.0))
        shape = shape * (scene.along(axis) / max(abs(low), abs(high)))
    return Disturbance(point=size * shape[:, None] * np.array([1.0, 1.0, 0.0]))


def _rate(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
    """A gradient in the frame follows how fast the air's temperature changes, and saturates."""
    bent = np.tanh(scene.rate("temperature_air") / parameters["rate"])
    return Disturbance(point=size * bent[:, None] * np.array([1.0, -0.5, 0.5]))


def _wave(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
    """An air conditioner that comes and goes."""
    swing = size * np.sin(2.0 * np.pi * scene.time / parameters["period"] + parameters["phase"])
    return Disturbance(reading=(lambda sight: swing,))


def _hysteresis(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
    """Lost motion in X that grows along Y, as a worn guideway has."""
    low, high = scene.ends.get("Y", (0.0, 1.0))
    worn = np.sin(np.pi * (scene.along("Y") - low) / (high - low))
    return Disturbance(axis={"X": -size * scene.toward("X") * worn * np.cos(parameters["turns"] * np.pi * worn)})


UNLISTED_FLAWS: tuple[Flaw, ...] = (
    Flaw(
        "unlisted_cubic_path",
        "reading: size * (change of path / scale)^3",
        "m",
        4e-6,
        _cubic,
        {"scale": 0.3},
        methods=INTERFEROMETERS,
    ),
    Flaw("unlisted_step", "reading: size from a moment on", "m", 3e-6, _step, draw=_moment),
    Flaw(
        "unlisted_product",
        "position in x and y: size * x * y / (ends of travel)",
        "m",
        5e-6,
        _product,
        methods=POSITIONS,
    ),
    Flaw(
        "unlisted_rate",
        "position: size * tanh(rate of the air's temperature / rate)",
        "m",
        5e-6,
        _rate,
        {"rate": 2e-4},
        methods=(*POSITIONS, "rotary_axis"),
    ),
    Flaw(
        "unlisted_wave",
        "reading: size * sin(2 pi time / period + phase)",
        "m",
        2e-6,
        _wave,
        {"period": 900.0},
        lambda rng, scene: {"phase": float(rng.uniform(0, 2 * np.pi))},
    ),
    Flaw(
        "unlisted_worn_guideway",
        "position of X: lost motion that varies along y",
        "m",
        3e-6,
        _hysteresis,
        {"turns": 2.0},
        methods=POSITIONS,
    ),
)
