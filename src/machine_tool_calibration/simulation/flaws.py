# SPDX-License-Identifier: Apache-2.0
"""Every flaw by its id, and those in no catalogue: what a diagnosis must call unexplained."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from machine_tool_calibration.errors import CalibrationError, did_you_mean
from machine_tool_calibration.simulation.flaw import (
    BEAM,
    LINEAR,
    Chosen,
    Disturbance,
    Flaw,
    Parameters,
    drawn_phase,
    reads,
)
from machine_tool_calibration.simulation.flaws_position import POSITION_FLAWS, REVERSAL_FLAWS, THERMAL_FLAWS
from machine_tool_calibration.simulation.flaws_reading import READING_FLAWS
from machine_tool_calibration.simulation.scene import Scene


def _moment(rng: np.random.Generator, scene: Scene | None) -> Parameters:
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
