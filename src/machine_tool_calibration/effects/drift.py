# SPDX-License-Identifier: Apache-2.0
"""What changes with time: the reading, the stations, a rotary table's place; and squareness, also with temperature."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import AxisEffect, Coefficient, Effect, table_axis
from machine_tool_calibration.effects.thermal import REFERENCE_TEMPERATURE
from machine_tool_calibration.machine.error_motions import squareness_field
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say, together

__all__ = ["LinearDrift", "RotaryAxisDrift", "SquarenessDrift", "SquarenessThermal", "StationDrift"]


class LinearDrift(Effect):
    """The reading runs away at one rate, in all setups."""

    id = "linear_drift"
    title = say("effect.drift")
    formula = say("formula.drift")
    source = "ISO 230-3, environmental temperature variation error"
    kind = "reading"
    coefficients = (Coefficient("r", "m/s", -1e-6, 1e-6, say("coefficient.rate")),)
    needs = ("time",)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Time since the start of the session."""
        return observations.readings.column("time")[None].copy()


class StationDrift(Effect):
    """Every station moves at a constant velocity of its own, from its first reading on."""

    id = "station_drift"
    title = say("effect.station_drift")
    formula = say("formula.station_drift")
    source = "Schwenke et al. 2005, drift of the tracking interferometer's mount"
    kind = "reading"
    coefficients = ()
    needs = ("time",)
    methods = ("tracking_interferometer", "rotary_axis")
    setup_level = True

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """A velocity for each station."""
        return tuple(
            Coefficient(f"{i}.v{axis}", "m/s", -1e-6, 1e-6, say("coefficient.station_velocity", setup=i, axis=axis))
            for i in observations.session.setup_ids
            for axis in "xyz"[: getattr(observations.session.description, "dimension", 3)]
        )

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Elapsed time times minus the beam's direction, for the readings of each station."""
        readings, d = observations.readings, getattr(observations.session.description, "dimension", 3)
        time = readings.column("time")
        out = np.zeros((len(observations.session.setup_ids), d, len(readings)))
        for s in np.unique(readings.setup):
            mine = readings.setup == s
            out[s][:, mine] = -observations.direction[mine, :d].T * (time[mine] - time[mine].min())
        return out.reshape(-1, len(readings))


class RotaryAxisDrift(Effect):
    """The table's axis average line moves and tilts at a constant rate, and all that the table carries with it.

    Where time and angle go together in every run (one way, one after the other), the error motions at the angles and
    the stations take most of it up; forth and back inside each run shows it. Probing shows the two shifts in its plane.
    """

    id = "rotary_axis_drift"
    title = say("effect.rotary_drift")
    formula = say("formula.rotary_drift")
    source = "ISO 230-3; ISO 230-7, axis average line"
    kind = "position"
    coefficients = (
        *(Coefficient(f"v{axis}", "m/s", -1e-7, 1e-7, say("coefficient.axis_velocity", axis=axis)) for axis in "xyz"),
        *(
            Coefficient(f"w{turn}", "rad/s", -1e-7, 1e-7, say("coefficient.axis_tilt_rate", turn=turn.upper()))
            for turn in "abc"
        ),
    )
    needs = ("time",)
    methods = ("rotary_axis", "probing")

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """Three shifts and the two tilts across the axis; two shifts where a part is probed in a plane."""
        if spec_of(observations.session).probes_surface:
            return self.coefficients[:2]
        along = 3 + "ABC".index(table_axis(observations))
        return tuple(c for k, c in enumerate(self.coefficients) if k != along)

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Time since the start of the session times what each motion changes through the table."""
        time = observations.readings.column("time")
        sensed = observations.table_direction
        motions = [*sensed.T, *np.cross(observations.position, sensed).T]
        names = [c.name for c in self.coefficients_for(observations)]
        return np.asarray([time * m for c, m in zip(self.coefficients, motions, strict=True) if c.name in names])


class SquarenessEffect(AxisEffect):
    """The angle between two axes does not stay: a column or a beam that warms on one side."""

    kind = "position"
    moves = "{AXIS}"

    def __init__(self, name: str) -> None:
        """Of A0Z, B0Z or C0Y."""
        self.chain = {"C0Y": "XY", "B0Z": "XZ", "A0Z": "YZ"}[name]
        super().__init__(name)

    def turned(self, observations: Observations, angle: Array) -> Array:
        """(1, n) what the squareness changes when it is so large in each reading, (n,) rad."""
        return np.asarray(angle * observations.sense(squareness_field(self.name, observations.position)[None]))


class SquarenessDrift(SquarenessEffect):
    """The angle between two axes changes at a constant rate."""

    id = "squareness_drift_{name}"
    title = say("effect.squareness_drift")
    formula = say("formula.squareness_drift")
    source = "ISO 230-3, distortion by moving axes and by the environment; ISO 230-1, squareness"
    coefficients = (Coefficient("r", "rad/s", -1e-7, 1e-7, say("coefficient.rate")),)
    needs = ("{axis}", "time")

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Time since the start of the session times what the squareness displaces."""
        return self.turned(observations, observations.readings.column("time"))


class SquarenessThermal(SquarenessEffect):
    """The angle between two axes changes with their temperature.

    It is the mean of the sensors of both; where only one of them was recorded, what that one shows.
    """

    id = "squareness_thermal_{name}"
    title = say("effect.squareness_thermal")
    formula = ""  # names the sensors
    source = "ISO 230-3, environmental temperature variation error; ISO 230-1, squareness"
    coefficients = (Coefficient("g", "rad/K", -1e-4, 1e-4, say("coefficient.per_kelvin")),)
    needs = ("{axis}",)

    def __init__(self, name: str) -> None:
        """Thermal change of A0Z, B0Z or C0Y."""
        super().__init__(name)
        self.sensors = tuple(f"temperature_{axis.lower()}" for axis in self.chain)
        sensors = together(self.sensors, say("text.and"))
        self.formula = say("formula.squareness_thermal", name=name, sensors=sensors)
        self.covariates = (*self.needs, *self.sensors)

    def why_not(self, observations: Observations) -> str | None:
        """One of the temperatures must have been recorded without gaps."""
        why = super().why_not(observations)
        if why is None and not self._recorded(observations):
            return f"neither {' nor '.join(self.sensors)} was recorded throughout"
        return why

    def _recorded(self, observations: Observations) -> list[Array]:
        found = [observations.readings.columns.get(name) for name in self.sensors]
        return [values for values in found if values is not None and np.isfinite(values).all()]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Excess temperature times what the squareness displaces."""
        return self.turned(observations, np.mean(self._recorded(observations), axis=0) - REFERENCE_TEMPERATURE)
