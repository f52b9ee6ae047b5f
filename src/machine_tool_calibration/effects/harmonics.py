# SPDX-License-Identifier: Apache-2.0
"""Effects that repeat with an angle, harmonics from the second order on; the pre-travel of a probe is one."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect, Shape
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

__all__ = ["HarmonicEffect", "ProbePretravel"]


_HIGHEST = (3.0, 5.0, 8.0)


class HarmonicEffect(Effect):
    """A reading that depends on an angle; sine and cosine of orders 2 up to the highest that the data asks for.

    The first order is left to the model: it is a shift of station, target or stylus.

    Attributes:
        limit: largest plausible amplitude, m.
    """

    kind = "reading"
    shapes = (Shape("highest_order", "1", 2.0, 8.0, discrete=True, meaning=say("coefficient.waves_most")),)
    limit: float

    @abstractmethod
    def angle(self, observations: Observations) -> Array:
        """(n,) the angle, rad."""

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """Sine and cosine coefficients of each order, m."""
        highest = int(shape[0]) if shape else int(_HIGHEST[-1])
        return tuple(
            Coefficient(f"{kind}{k}", "m", -self.limit, self.limit, say(f"coefficient.waves_{part}", n=k))
            for k in range(2, highest + 1)
            for kind, part in (("s", "sine"), ("c", "cosine"))
        )

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """Few orders, or many."""
        return [(highest,) for highest in _HIGHEST]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Sine and cosine of each order."""
        angle = self.angle(observations)
        return np.array([wave(k * angle) for k in range(2, int(shape[0]) + 1) for wave in (np.sin, np.cos)])


class ProbePretravel(HarmonicEffect):
    """The way from contact to trigger depends on the direction of the contact's normal (three lobes, typically)."""

    id = "probe_pretravel"
    title = say("effect.pretravel")
    formula = say("formula.harmonics", angle=say("formula.angle_normal"))
    source = "ISO 230-10, pre-travel variation"
    coefficients = ()
    limit = 3e-5
    covariates = ("normal",)
    methods = ("probing",)

    def angle(self, observations: Observations) -> Array:
        """Direction of the normal in the machine frame."""
        normal = observations.table_direction
        return np.asarray(np.arctan2(normal[:, 1], normal[:, 0]))
