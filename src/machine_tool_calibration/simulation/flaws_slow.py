# SPDX-License-Identifier: Apache-2.0
"""Flaws that come slowly: a squareness that drifts, a structure behind its sensor, a table that wanders."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.simulation.disturbance import Disturbance
from machine_tool_calibration.simulation.flaw import Flaw, Parameters
from machine_tool_calibration.simulation.flaws_position import LINEAR
from machine_tool_calibration.simulation.motions import rotate
from machine_tool_calibration.simulation.scene import Scene

__all__ = ["THERMAL_FLAWS"]

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

    return Flaw(f"squareness_thermal_{name}", f"squareness {name} = size * (mean of {' and '.join(columns)} - 20)",
                "rad/K", 1e-5, disturb, {"reference": 20.0}, methods=LINEAR)


def _lag(axis: str) -> Flaw:
    """A heavy bed behind the sensor on its surface."""
    column = f"temperature_{axis.lower()}"

    def disturb(size: float, parameters: Parameters, scene: Scene) -> Disturbance:
        warm = scene.sensed_late(column, parameters["tau"]) - parameters["reference"]
        return Disturbance(axis={axis: size * warm * (scene.along(axis) - parameters["fixed_point"])})

    return Flaw(f"thermal_lag_{axis.lower()}",
                f"position of {axis}: size * ({column} behind by tau - 20) * ({axis.lower()} - fixed_point)",
                "1/K", 1e-5, disturb, {"tau": 1200.0, "reference": 20.0, "fixed_point": 0.0}, methods=LINEAR)


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
    *(_lag(axis) for axis in "XYZ"),
    Flaw("rotary_axis_drift", "axis of the table moves by size * time along direction, and tilts by tilt (rad/m) of it",
         "m/s", 2e-9, _rotary_drift, {"tilt": 3.0}, _direction, ("rotary_axis", "probing")),
)
