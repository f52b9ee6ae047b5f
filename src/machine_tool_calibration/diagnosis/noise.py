"""What is known of the noise of the readings, and whether the model fits within it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from machine_tool_calibration.arrays import IntArray
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.observations import Observations

__all__ = ["Noise", "noise_of", "same_place"]


@dataclass(frozen=True)
class Noise:
    """Noise of one reading, standard uncertainty in m.

    Attributes:
        declared: what the session says.
        from_repeats: from readings repeated at the same place in the same setup; None without such.
        repeats: degrees of freedom of the latter.
        chi_square_p: chance of so large residuals if the model is right and the declared uncertainty too.
        lack_of_fit_p: chance of so much scatter between places, against that between repeats (F test); None without.
    """

    declared: float
    from_repeats: float | None
    repeats: int
    chi_square_p: float
    lack_of_fit_p: float | None


def same_place(observations: Observations) -> IntArray:
    """(n,) index shared by readings that repeat each other: same setup, place, target and direction of approach."""
    readings = observations.readings
    keys = [readings.setup.astype(float)]
    keys += [np.round(readings.columns[a] * 1e9) for a in "xyzc" if a in readings.columns]
    keys += [readings.columns[f"dir_{a}"] for a in "xyzc" if f"dir_{a}" in readings.columns]
    for values in readings.labels.values():
        keys.append(np.unique(values, return_inverse=True)[1].astype(float))
    return np.asarray(np.unique(np.stack(keys), axis=1, return_inverse=True)[1].reshape(-1))


def noise_of(fit: Fit) -> Noise:
    """Compare residuals with the declared uncertainty and with repeats."""
    place = same_place(fit.model.observations)
    residuals = fit.residuals
    count = np.bincount(place)
    mean = np.bincount(place, residuals) / count
    pure = float(np.sum((residuals - mean[place]) ** 2))
    # Each run brings unknowns of its own (its datum) that the repeats cannot tell from noise.
    free = int((count - 1).sum())
    declared = fit.model.observations.session.sigma
    dof = fit.solution.degrees_of_freedom
    from_repeats, lack = None, None
    if free >= 5:
        from_repeats = float(np.sqrt(pure / free))
        lacking = float(np.sum(residuals**2)) - pure
        if dof - free > 0:
            lack = float(stats.f.sf((lacking / (dof - free)) / max(pure / free, 1e-300), dof - free, free))
    return Noise(declared, from_repeats, free, fit.joint.p_value, lack)
