# SPDX-License-Identifier: Apache-2.0
"""Squareness that does not stay: with time, or with the temperature of the two axes."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect
from machine_tool_calibration.effects.thermal_expansion import REFERENCE_TEMPERATURE
from machine_tool_calibration.machine.error_motions import squareness_field
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say, together

__all__ = ["SquarenessDrift", "SquarenessThermal"]

_BETWEEN = {"C0Y": "xy", "B0Z": "xz", "A0Z": "yz"}
_STILL = 1e-6  # m


def _why_not(name: str, observations: Observations) -> str | None:
    """Both axes must be in the chain, and the one that turns must have moved."""
    linear = observations.session.description.machine.kinematics.linear
    for axis in _BETWEEN[name].upper():
        if axis not in linear:
            return f"the chain has no axis {axis}"
    axis = name[2].lower()
    if np.ptp(observations.readings.column(axis)) < _STILL:
        return f"{axis.upper()} did not move"
    return None


class SquarenessDrift(Effect):
    """The angle between two axes changes at a constant rate: a column or a beam that warms on one side."""

    kind = "position"
    source = "ISO 230-3, distortion by moving axes and by the environment; ISO 230-1, squareness"

    def __init__(self, name: str) -> None:
        """Drift of A0Z, B0Z or C0Y."""
        self.name = name
        self.id = f"squareness_drift_{name}"
        self.title = say("effect.squareness_drift", name=name)
        self.formula = say("formula.squareness_drift", name=name)
        self.coefficients = (Coefficient("r", "rad/s", -1e-7, 1e-7, say("coefficient.rate")),)
        self.needs = (name[2].lower(), "time")

    def why_not(self, observations: Observations) -> str | None:
        """See `_why_not`."""
        return super().why_not(observations) or _why_not(self.name, observations)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Time since the start of the session times what the squareness displaces."""
        time = observations.readings.column("time")
        return np.asarray(time * observations.sense(squareness_field(self.name, observations.position)[None]))


class SquarenessThermal(Effect):
    """The angle between two axes changes with their temperature.

    It is the mean of the sensors of both; where only one of them was recorded, what that one shows.
    """

    kind = "position"
    source = "ISO 230-3, environmental temperature variation error; ISO 230-1, squareness"

    def __init__(self, name: str) -> None:
        """Thermal change of A0Z, B0Z or C0Y."""
        self.name = name
        self.id = f"squareness_thermal_{name}"
        self.title = say("effect.squareness_thermal", name=name)
        self.sensors = tuple(f"temperature_{axis}" for axis in _BETWEEN[name])
        sensors = together(self.sensors, say("text.and"))
        self.formula = say("formula.squareness_thermal", name=name, sensors=sensors)
        self.coefficients = (Coefficient("g", "rad/K", -1e-4, 1e-4, say("coefficient.per_kelvin")),)
        self.needs = (name[2].lower(),)
        self.covariates = (name[2].lower(), *self.sensors)

    def why_not(self, observations: Observations) -> str | None:
        """See `_why_not`; and one of the temperatures must have been recorded without gaps."""
        why = super().why_not(observations) or _why_not(self.name, observations)
        if why is None and not self._recorded(observations):
            return f"neither {' nor '.join(self.sensors)} was recorded throughout"
        return why

    def _recorded(self, observations: Observations) -> list[Array]:
        columns = observations.readings.columns
        found = [columns[name] for name in self.sensors if name in columns]
        return [values for values in found if np.isfinite(values).all()]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Excess temperature times what the squareness displaces."""
        excess = np.mean(self._recorded(observations), axis=0) - REFERENCE_TEMPERATURE
        return np.asarray(excess * observations.sense(squareness_field(self.name, observations.position)[None]))
