# SPDX-License-Identifier: Apache-2.0
"""Periodic error of a ball screw or scale."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import AxisEffect, Coefficient, Shape
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say

_SHORTEST_LEAD = 2e-3  # m
_MOST_LEADS = 80  # that are tried
# Share of the shortest wave, and of the range, within which positions are one place: no wave differs there.
_ONE_PLACE, _OF_RANGE = 0.05, 0.01
# Leads of ball screws, mm, and half of them: tried one by one where so many short waves fit into the range that they
# cannot all be.
_LEADS = (4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0, 30.0, 32.0, 40.0)
# Waves in the range, at least: fewer are a curve, whose cause need not be a screw.
_WAVES, _WAVES_OF_MACHINE = 1.0, 1.5


class PitchPeriodic(AxisEffect):
    """Once a lead of the screw, or once a period of the scale; sine and cosine hold amplitude and phase."""

    id = "pitch_periodic_{axis}"
    title = say("effect.periodic")
    formula = "e_{axis} = s sin(2 pi {axis} / lead) + c cos(2 pi {axis} / lead)"
    kind = "position"
    source = "ISO 230-2:2014, periodic positioning error"
    coefficients = (
        Coefficient("s", "m", -5e-5, 5e-5, say("coefficient.wave_sine")),
        Coefficient("c", "m", -5e-5, 5e-5, say("coefficient.wave_cosine")),
    )
    shapes = (Shape("lead", "m", _SHORTEST_LEAD, 1.0, meaning=say("coefficient.wave_length")),)
    needs = ("{axis}",)

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """Leads from the range covered down to what the positions can resolve.

        On evenly spaced positions every lead shorter than two steps looks like a longer one: only those are searched.
        """
        position = _places(observations.readings.column(self.axis))
        if len(position) < 4:
            return []
        span = float(np.ptp(position))
        steps = np.diff(position)
        even = float(np.ptp(steps)) < 1e-3 * float(steps.mean())
        shortest = 2.0 * float(steps.mean()) if even else max(_SHORTEST_LEAD, float(steps.mean()))
        direct = spec_of(observations.session).reads_machine
        fewest = _WAVES_OF_MACHINE if direct else _WAVES
        frequency = np.arange(fewest / span, 1.0 / shortest * (1.0 + 1e-9), 0.4 / span)
        if len(frequency) > _MOST_LEADS and direct:
            # Long waves without a gap, and the usual leads beyond.
            known = np.unique([1e3 / (lead * share) for lead in _LEADS for share in (1.0, 0.5)])
            frequency = frequency[: _MOST_LEADS - len(known)]
            beyond = known[(known > frequency[-1] + 0.2 / span) & (known <= 1.0 / shortest)]
            frequency = np.concatenate([frequency, beyond])
        elif len(frequency) > _MOST_LEADS:
            frequency = np.linspace(frequency[0], frequency[-1], _MOST_LEADS)
        return [(float(1.0 / f),) for f in frequency]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Sine and cosine of the position, along the axis."""
        angle = 2.0 * np.pi * observations.readings.column(self.axis) / shape[0]
        along = self.along(observations)
        return np.asarray([np.sin(angle) * along, np.cos(angle) * along])


def _places(position: Array) -> Array:
    """The first position of each place, in increasing order, m."""
    ordered = np.unique(np.round(position, 7))
    apart = min(_ONE_PLACE * _SHORTEST_LEAD, _OF_RANGE * float(np.ptp(ordered)))
    first, out = 0, []
    while first < len(ordered):
        out.append(ordered[first])
        # Positions are rounded; those that are evenly spaced stay so.
        first = max(first + 1, int(np.searchsorted(ordered, out[-1] + 0.999 * apart)))
    return np.array(out)
