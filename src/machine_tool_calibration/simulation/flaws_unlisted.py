# SPDX-License-Identifier: Apache-2.0
"""Flaws in no catalogue: what a diagnosis must call unexplained."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.simulation.disturbance import Disturbance, Sight
from machine_tool_calibration.simulation.flaw import BEAM, LINEAR, Flaw, Parameters, drawn_phase, reads
from machine_tool_calibration.simulation.scene import Scene

__all__ = ["UNLISTED_FLAWS"]


def _cubic(size: float, given: Parameters, _: Scene, sight: Sight) -> Array:
    """A counting error that grows with the cube of the change of path."""
    return np.asarray(size * (sight.change / given["scale"]) ** 3)


def _step(size: float, given: Parameters, scene: Scene, _: Sight) -> Array:
    """The instrument is knocked: all later readings are off by `size`."""
    return np.where(scene.time >= given["moment"], size, 0.0)


def _moment(rng: np.random.Generator, scene: Scene | None) -> Parameters:
    if scene is None or len(scene) < 3:
        return {"moment": 600.0}
    return {"moment": float(scene.time[int(rng.uniform(0.3, 0.7) * len(scene))])}


def _wave(size: float, given: Parameters, scene: Scene, _: Sight) -> Array:
    """An air conditioner that comes and goes."""
    return np.asarray(size * np.sin(2.0 * np.pi * scene.time / given["period"] + given["phase"]))


def _product(size: float, _: Parameters, scene: Scene) -> Disturbance:
    """The structure twists: an error in all directions with the product x y, as no rigid body has."""
    shape = np.ones(len(scene))
    for axis in "XY":
        low, high = scene.ends.get(axis, (0.0, 1.0))
        shape = shape * (scene.along(axis) / max(abs(low), abs(high)))
    return Disturbance(point=size * shape[:, None] * np.array([1.0, 1.0, 0.0]))


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
    Flaw("unlisted_cubic_path", "reading: size * (change of path / scale)^3", "m", 4e-6, reads(_cubic), {"scale": 0.3},
         methods=BEAM),
    Flaw("unlisted_step", "reading: size from a moment on", "m", 3e-6, reads(_step), draw=_moment),
    Flaw("unlisted_product", _PRODUCT, "m", 5e-6, _product, methods=LINEAR),
    Flaw("unlisted_rate", _RATE, "m", 5e-6, _rate, {"rate": 2e-4}, methods=(*LINEAR, "rotary_axis")),
    Flaw("unlisted_wave", _WAVE, "m", 2e-6, reads(_wave), {"period": 900.0}, drawn_phase),
    Flaw("unlisted_worn_guideway", _WORN, "m", 3e-6, _hysteresis, {"turns": 2.0}, methods=LINEAR),
)  # fmt: skip
