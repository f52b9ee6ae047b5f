# SPDX-License-Identifier: Apache-2.0
"""Positioning of one axis by ISO 230-2:2014: reversal, repeatability, systematic deviation, accuracy.

Clause 3 of the standard: at m positions P_i, each approached n times in the positive direction (up) and n times in the
negative one (down), the deviations x_ij are actual minus target position.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.errors import ModelError

__all__ = ["Positioning", "positioning", "positioning_uncertainty"]

_DRAWS = 200


@dataclass(frozen=True)
class Positioning:
    """Figures of one axis; NaN where the readings do not give them (a direction or repeats missing).

    Attributes:
        position: (m,) target positions, m.
        mean_up, mean_down: (m,) mean unidirectional deviations, 3.10.
        s_up, s_down: (m,) estimators of the unidirectional repeatability (standard deviation with n - 1), 3.13.
        count_up, count_down: (m,) readings in each direction.
        reversal: (m,) mean_up - mean_down, 3.11.
        repeatability: (m,) R_i = max(2 s_up + 2 s_down + |B_i|, 4 s_up, 4 s_down), 3.15.
        B, B_mean: largest absolute, and mean reversal of the axis, 3.11, 3.12.
        R_up, R_down, R: uni- and bidirectional repeatability of the axis, 3.14, 3.15.
        E_up, E_down, E: uni- and bidirectional systematic positioning deviation, 3.16, 3.17.
        M: range of the mean bidirectional positioning deviation, 3.18.
        A_up, A_down, A: uni- and bidirectional positioning accuracy (two standard deviations), 3.19, 3.20.
    """

    position: Array
    mean_up: Array
    mean_down: Array
    s_up: Array
    s_down: Array
    count_up: IntArray
    count_down: IntArray
    reversal: Array
    repeatability: Array
    B: float
    B_mean: float
    R_up: float
    R_down: float
    R: float
    E_up: float
    E_down: float
    E: float
    M: float
    A_up: float
    A_down: float
    A: float


def positioning(position: Array, direction: Array, deviation: Array) -> Positioning:
    """The figures of ISO 230-2:2014 from the readings of one axis.

    A figure that takes the worst of all positions is given only where every position has what it needs.

    Args:
        position: (n,) target position of each reading, m; readings of one position hold the same number.
        direction: (n,) +1 approached in the positive direction, -1 in the negative one.
        deviation: (n,) actual minus target position, m.

    Raises:
        ModelError: the arrays differ in length, no reading, or a direction that is not +1 or -1.
    """
    if not len(position) == len(direction) == len(deviation):
        raise ModelError("ISO 230-2: position, direction and deviation must have the same length")
    good = np.isfinite(deviation) & np.isfinite(position)
    position, direction, deviation = position[good], np.asarray(direction)[good], deviation[good]
    if not len(position):
        raise ModelError("ISO 230-2: no reading")
    if not np.isin(direction, (-1, 1)).all():
        raise ModelError("ISO 230-2: the direction of approach must be +1 or -1 for every reading")
    target, index = np.unique(position, return_inverse=True)
    m = len(target)
    up_mean, up_s, up_n = _statistics(index.reshape(-1), deviation, direction > 0, m)
    down_mean, down_s, down_n = _statistics(index.reshape(-1), deviation, direction < 0, m)
    return Positioning(
        position=target,
        mean_up=up_mean,
        mean_down=down_mean,
        s_up=up_s,
        s_down=down_s,
        count_up=up_n,
        count_down=down_n,
        reversal=up_mean - down_mean,
        repeatability=_repeatability(up_mean, up_s, down_mean, down_s),
        **{name: float(value) for name, value in _of_axis(up_mean, up_s, down_mean, down_s).items()},
    )


def _repeatability(up_mean: Array, up_s: Array, down_mean: Array, down_s: Array) -> Array:
    both = 2 * up_s + 2 * down_s + np.abs(up_mean - down_mean)
    return np.asarray(np.max(np.stack([both, 4 * up_s, 4 * down_s]), axis=0))


def _of_axis(up_mean: Array, up_s: Array, down_mean: Array, down_s: Array) -> dict[str, Array]:
    """The axis's figures by name, each (…), from means and standard deviations (…, m) at its positions."""
    reversal = up_mean - down_mean
    means, s = np.concatenate([up_mean, down_mean], axis=-1), np.concatenate([up_s, down_s], axis=-1)
    return {
        "B": np.max(np.abs(reversal), axis=-1),
        "B_mean": np.mean(reversal, axis=-1),
        "R_up": np.max(4 * up_s, axis=-1),
        "R_down": np.max(4 * down_s, axis=-1),
        "R": np.max(_repeatability(up_mean, up_s, down_mean, down_s), axis=-1),
        "E_up": np.ptp(up_mean, axis=-1),
        "E_down": np.ptp(down_mean, axis=-1),
        "E": np.ptp(means, axis=-1),
        "M": np.ptp((up_mean + down_mean) / 2, axis=-1),
        "A_up": _accuracy(up_mean, up_s),
        "A_down": _accuracy(down_mean, down_s),
        "A": _accuracy(means, s),
    }


def _accuracy(mean: Array, s: Array) -> Array:
    return np.asarray(np.max(mean + 2 * s, axis=-1) - np.min(mean - 2 * s, axis=-1))


def _statistics(index: IntArray, deviation: Array, mine: BoolArray, m: int) -> tuple[Array, Array, IntArray]:
    """Mean, standard deviation (…, m) and number (m,) of the deviations (…, n) of one direction at each position."""
    own, index = deviation[..., mine], index[mine]
    draws = int(np.prod(own.shape[:-1]))
    bins = (m * np.arange(draws)[:, None] + index).reshape(-1)

    def total(values: Array) -> Array:
        return np.asarray(np.bincount(bins, values.reshape(-1), minlength=draws * m), float).reshape(*own.shape[:-1], m)

    count = np.bincount(index, minlength=m)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total(own) / np.where(count > 0, count, np.nan)
        s = np.sqrt(total((own - mean[..., index]) ** 2) / np.where(count > 1, count - 1, np.nan))
    return mean, s, count


def positioning_uncertainty(figures: Positioning) -> dict[str, float]:
    """Expanded uncertainty (k = 2) of the figures from the repeatability that they were found with.

    Every figure is worked out again for runs that are drawn about the means with the standard deviations found; twice
    the standard deviation of what comes out. The uncertainty of the instrument and of its alignment and temperature
    (the standard's Annex A, from certificates that a session does not hold) is not in it.

    Args:
        figures: of one axis, with at least two runs in each direction in which it was measured.

    Returns:
        By figure: B, B_mean, R, E, M, A; those that the readings do not give are left out.
    """
    rng = np.random.default_rng(1)
    position, direction, centre, spread = [], [], [], []
    for sign, mean, s, count in (
        (1, figures.mean_up, figures.s_up, figures.count_up),
        (-1, figures.mean_down, figures.s_down, figures.count_down),
    ):
        runs = int(count.max(initial=0))
        for k in range(runs):
            there = np.flatnonzero((count > k) & np.isfinite(s))
            position.append(figures.position[there])
            direction.append(np.full(len(there), sign))
            centre.append(mean[there])
            spread.append(s[there])
    if not position or not sum(len(p) for p in position):
        return {}
    at, sense, mean, s = (np.concatenate(parts) for parts in (position, direction, centre, spread))
    drawn = mean + s * rng.standard_normal((_DRAWS, len(s)))
    target, index = np.unique(at, return_inverse=True)
    up_mean, up_s, _ = _statistics(index.reshape(-1), drawn, sense > 0, len(target))
    down_mean, down_s, _ = _statistics(index.reshape(-1), drawn, sense < 0, len(target))
    of_axis = _of_axis(up_mean, up_s, down_mean, down_s)
    out = {name: 2.0 * float(np.std(of_axis[name])) for name in ("B", "B_mean", "R", "E", "M", "A")}
    return {name: value for name, value in out.items() if np.isfinite(value) and np.isfinite(getattr(figures, name))}
