# SPDX-License-Identifier: Apache-2.0
"""Families of effects: against the last move, round circles, late, of a beam's air, of a squareness, in harmonics."""

from abc import abstractmethod

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.effects.effect import AxisEffect, Coefficient, Effect, Shape
from machine_tool_calibration.instruments.refractive_index import index_deviation
from machine_tool_calibration.machine.error_motions import SQUARENESS, squareness_field
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

# Highest orders of harmonics that are tried.
_HIGHEST_ORDERS = (3.0, 5.0, 8.0)


class ReversalEffect(AxisEffect):
    """An effect against the direction of the axis's last move."""

    kind = "position"
    needs: tuple[str, ...] = ("{axis}", "dir_{axis}")

    def approach(self, observations: Observations) -> Array:
        """(n,) sign of the last move."""
        return observations.readings.column(f"dir_{self.axis}")


class CircleEffect(ReversalEffect):
    """An effect of an axis on its way round a circle, which a ball bar reads."""

    methods = ("ball_bar",)

    def is_in_plane(self, observations: Observations) -> BoolArray:
        """(n,) whether the circle of each reading lies along the axis."""
        setup = observations.readings.setup
        return np.asarray(np.bincount(setup, np.abs(self.along(observations)))[setup] > 0.0)


class LateEffect(AxisEffect):
    """An effect with one time constant."""

    kind = "position"
    shapes = (Shape("tau", "s", 10.0, 1e5, meaning=say("coefficient.time_constant")),)

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """From a fiftieth of the session to its whole length; a longer time constant shows a rate of change only."""
        length = float(np.ptp(observations.readings.column("time"))) or 1.0
        return [(float(tau),) for tau in np.geomspace(length / 50, length, 12)]


class AirEffect(Effect):
    """An effect of the air in a beam whose wavelength measures."""

    kind = "reading"
    needs = ("temperature_air",)
    covariates: tuple[str, ...] = ("temperature_air", "air_pressure", "relative_humidity")
    methods = ("step_diagonal", "tracking_interferometer", "rotary_axis", "direct")
    instruments = ("laser_interferometer", "tracking_interferometer", "laser_tracker")

    def deviation(self, observations: Observations) -> Array:
        """(n,) refractive index minus that of standard air."""
        columns = observations.readings.columns
        others = columns.get("air_pressure"), columns.get("relative_humidity")
        return index_deviation(columns["temperature_air"], *others)


class SquarenessEffect(AxisEffect):
    """The angle between two axes does not stay: a column or a beam that warms on one side."""

    kind = "position"
    moves = "{AXIS}"
    seldom = True

    def __init__(self, name: str) -> None:
        """Of A0Z, B0Z or C0Y."""
        self.chain = SQUARENESS[name]
        super().__init__(name)

    def turned(self, observations: Observations, angle: Array) -> Array:
        """(1, n) what the squareness changes when it is so large in each reading, (n,) rad."""
        return np.asarray(angle * observations.sense(squareness_field(self.name, observations.position)[None]))


class HarmonicEffect(Effect):
    """A reading that depends on an angle; sine and cosine of orders 2 up to the highest that the data asks for.

    The first order is left to the model: it is a shift of station, target or stylus.
    """

    kind = "reading"
    shapes: tuple[Shape, ...] = (
        Shape("highest_order", "1", 2.0, 8.0, discrete=True, meaning=say("coefficient.waves_most")),
    )
    limit: float  # largest plausible amplitude, m

    @abstractmethod
    def angle(self, observations: Observations) -> Array:
        """(n,) the angle, rad."""

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """Sine and cosine coefficients of each order, m."""
        highest = int((shape or _HIGHEST_ORDERS[-1:])[0])
        return tuple(
            Coefficient(f"{kind}{k}", "m", -self.limit, self.limit, say(f"coefficient.waves_{part}", n=k))
            for k in range(2, highest + 1)
            for kind, part in (("s", "sine"), ("c", "cosine"))
        )

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """Few orders, or many."""
        return [(highest,) for highest in _HIGHEST_ORDERS]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Sine and cosine of each order."""
        angle = self.angle(observations)
        return np.array([wave(k * angle) for k in range(2, int(shape[0]) + 1) for wave in (np.sin, np.cos)])
