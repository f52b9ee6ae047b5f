# SPDX-License-Identifier: Apache-2.0
"""Vibration of an axis, periodic in time: e_x = a sin(2 pi f t + phase) (ISO 230-4:2005, Annex B)."""

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, means_of
from machine_tool_calibration.effects.effect import AxisEffect, Coefficient, Shape
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.words import say

# Times the usual interval of a setup's readings from which a run ends: the way round changes, or the bar is set up.
_NEW_RUN = 2.5
# Readings of a run from which it has frequencies.
_FEWEST = 3
# Waves of a run, at least: fewer are a form of the circle. Step of the frequencies, over one over the longest run.
_WAVES, _STEP = 4.0, 0.4
# Frequencies that are tried; most readings of a run that are transformed.
_TRIED, _MOST = 6, 2**18


class Vibration(AxisEffect):
    """An amplitude and a phase of each run, as nothing keeps a wave in step from run to run, and one frequency.

    What a screw or a scale does is periodic in position, and as long at every feed (`pitch_periodic`); this is periodic
    in time. A frequency above half the rate of the readings shows folded back below it.
    """

    id = "vibration_{axis}"
    title = say("effect.vibration")
    formula = "e_{axis} = s sin(2 pi frequency t) + c cos(2 pi frequency t)"
    kind = "position"
    source = "ISO 230-4:2005, Annex B"
    shapes = (Shape("frequency", "Hz", 1e-3, 1e4, meaning=say("coefficient.frequency"), step=1e-7),)
    # of a bar on the move: at rest each reading is a mean over its dwell
    needs = ("{axis}", "time", "feed")
    methods = ("ball_bar",)
    chain = moves = "{AXIS}"
    setup_level = True

    def coefficients_for(self, observations: Observations, shape: tuple[float, ...] = ()) -> tuple[Coefficient, ...]:
        """Sine and cosine of each run, m."""
        return tuple(
            Coefficient(f"{part[0]}{run + 1}", "m", -2e-5, 2e-5, say(f"coefficient.vibration_{part}", n=run + 1))
            for run in range(int(_runs(observations).max()) + 1)
            for part in ("sine", "cosine")
        )

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Sine and cosine of the time, along the axis, run by run."""
        run, along, clock = _runs(observations), self.along(observations), observations.clock
        # From the middle of each run, so that the frequency and the phases are told apart.
        angle = 2.0 * np.pi * shape[0] * (clock - means_of(run, clock))
        each = [np.where(run == k, wave(angle) * along, 0.0) for k in range(run.max() + 1) for wave in (np.sin, np.cos)]
        return np.array(each)

    def equally(self, observations: Observations, shape: tuple[float, ...]) -> int:
        """All frequencies, of which the likeliest are tried."""
        return len(_frequencies(observations))

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """The frequencies at which the readings vary most along the axis."""
        tried, run = _frequencies(observations), _runs(observations)
        power, along, left = np.zeros(len(tried)), self.along(observations), _without_form(observations, run)
        for mine in (run == k for k in range(run.max() + 1)):
            time, seen = observations.clock[mine], left[mine] * along[mine]
            if len(time) < _FEWEST or not np.ptp(time):
                continue
            count = min(len(time), _MOST)
            even = np.linspace(time[0], time[-1], count)
            spectrum = np.fft.rfft(np.interp(even, time, seen), n=int(count / _STEP))
            at = np.fft.rfftfreq(int(count / _STEP), even[1] - even[0])
            squares = max(float(along[mine] @ along[mine]), 1e-9)
            power += np.interp(tried, at, np.abs(spectrum) ** 2 / squares, right=0.0)
        return [(float(tried[k]),) for k in np.sort(np.argsort(-power, kind="stable")[:_TRIED])]


def _runs(observations: Observations) -> IntArray:
    """(n,) number of each reading's run: of one setup and repeat, without a gap in time."""
    readings, step = observations.readings, np.diff(observations.clock, prepend=observations.clock[:1])
    new = np.zeros(len(step), dtype=bool)
    for mine in (readings.setup == s for s in np.unique(readings.setup)):
        new[mine] = np.abs(step[mine]) > _NEW_RUN * np.median(np.abs(step[mine]))
    for key in (readings.setup, readings.repeat):
        new |= np.diff(key, prepend=key[:1]) != 0
    return np.asarray(np.cumsum(new))


def _frequencies(observations: Observations) -> Array:
    """(k,) from a few waves in the shortest run up to half the highest rate of the readings, Hz."""
    run, clock = _runs(observations), observations.clock
    times = [own for own in (clock[run == k] for k in range(run.max() + 1)) if len(own) >= _FEWEST and np.ptp(own)]
    if not times:
        return np.zeros(0)
    length = [float(np.ptp(own)) for own in times]
    highest = max(0.5 / float(np.median(np.diff(own))) for own in times)
    return np.arange(_WAVES / min(length), highest, _STEP / max(length))


def _without_form(observations: Observations, run: IntArray) -> Array:
    """(n,) the readings without the form of each run's circle up to the second order, m."""
    left = observations.readings.displacement.copy()
    u = observations.direction
    base = np.column_stack([np.ones(len(u)), u, u[:, 0] * u[:, 1], u[:, 1] * u[:, 2], u[:, 2] * u[:, 0], u**2])
    for mine in (run == k for k in range(run.max() + 1)):
        left[mine] -= base[mine] @ np.linalg.lstsq(base[mine], left[mine], rcond=1e-9)[0]
    return left
