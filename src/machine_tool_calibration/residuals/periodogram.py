# SPDX-License-Identifier: Apache-2.0
"""Waves in residuals: at which periods they are strongest."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array

__all__ = ["strongest_periods"]

# Frequencies of the periodogram for each independent one, its largest peaks that are looked at, and the fewest periods
# over the whole session: slower waves are smooth functions.
_OVERSAMPLED, _PEAKS, _FEWEST = 4, 8, 2.5
_MOST_FREQUENCIES = 20000
# Numbers that are worked on at once; sum of squares of a wave below which it is zero at all readings.
_AT_ONCE, _NOTHING = 4e5, 1e-12


def strongest_periods(time: Array, residual: Array) -> list[float]:
    """Periods of the largest peaks of the periodogram (Lomb 1976, Scargle 1982).

    From the session's length down to two readings'. Only these are looked at more closely: at all others less is to
    be explained.
    """
    length = float(np.ptp(time))
    highest = len(time) / (2.0 * length)
    lowest = _FEWEST / length
    count = int(min(_OVERSAMPLED * (highest - lowest) * length, _MOST_FREQUENCIES))
    if count < 3 or not residual.any():
        return []
    frequency = np.linspace(lowest, highest, count)
    power = _periodogram(time - time[0], residual - residual.mean(), frequency)
    # The ends may be peaks as well.
    padded = np.pad(power, 1)
    peaks = np.flatnonzero((power > padded[:-2]) & (power >= padded[2:]))
    best = peaks[np.argsort(-power[peaks])][:_PEAKS]
    step = float(frequency[1] - frequency[0])
    return [float(1.0 / (frequency[k] + shift)) for k in best for shift in (-0.5 * step, 0.0, 0.5 * step)]


def _periodogram(time: Array, values: Array, frequency: Array) -> Array:
    """(f,) sum of squares that a sine and a cosine of each frequency take up.

    `scipy.signal.lombscargle` gives half of it; to load it takes longer than all else here.
    """
    out = np.empty(len(frequency))
    step = max(int(_AT_ONCE / len(time)), 1)
    for part in (slice(k, k + step) for k in range(0, len(frequency), step)):
        phase = 2.0 * np.pi * frequency[part, None] * time
        sine, cosine = np.sin(phase), np.cos(phase)
        # Turned by the phase at which the two are orthogonal (Lomb 1976).
        turn = 0.5 * np.arctan2(2.0 * np.sum(sine * cosine, axis=1), np.sum(cosine**2 - sine**2, axis=1))[:, None]
        sine, cosine = sine * np.cos(turn) - cosine * np.sin(turn), cosine * np.cos(turn) + sine * np.sin(turn)
        out[part] = sum((wave @ values) ** 2 / np.maximum(np.sum(wave**2, axis=1), _NOTHING) for wave in (sine, cosine))
    return out
