# SPDX-License-Identifier: Apache-2.0
"""What is known of the noise of the readings, and whether the model fits within it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import linalg, special

from machine_tool_calibration.arrays import Array, means_of, rms
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.model.fit import Fit, fit_models, screen
from machine_tool_calibration.model.reproducibility import reproducibility
from machine_tool_calibration.residuals.leverage import leverage
from machine_tool_calibration.session.catalogue import spec_of

# More places than this are not compared one by one.
_MOST_PLACES = 1500
# Readings that a model leaves of a session, below which it leaves none.
_LEAST_LEFT = 1e-6
# Share of the range of the readings below which two of them are the same but for the computer's rounding.
_SAME_READING = 1e-9
# Digits of the least difference of rounded readings, at most, and of what a number is off for the computer.
_PARTS_OF_STEP, _NEARLY_WHOLE = 4, 0.02


@dataclass(frozen=True)
class Noise:
    """Noise of one reading, standard uncertainty in m."""

    declared: float  # what the session says
    # from readings repeated at the same place in the same setup, not less than what rounding them to the last digit
    # comes to; None without such
    from_repeats: float | None
    repeats: int  # degrees of freedom of the latter
    # probability of so large residuals of its own if the model is right and the declared uncertainty too
    chi_square_p: float
    # probability that places differ so much more than repeats at one place do (F test, with the spread between runs
    # subtracted from both); None without repeats
    lack_of_fit_p: float | None
    # what repeats of one place differ by as they were read, with all that differs from run to run; None without
    # repeats, and where each run counts from a zero of its own
    as_read: float | None = None

    def is_all(self, repeats: float | None, reduced_chi_square: float, share: float = priors.AS_NOISY) -> bool:
        """Whether repeats, m, scatter as much as this share of what a model with this reduced chi-square leaves."""
        scatter = np.sqrt(reduced_chi_square) * self.declared
        return repeats is not None and bool(repeats > share * scatter)


def noise_of(fit: Fit) -> Noise:
    """Compare residuals with the declared uncertainty and with repeats.

    What does not reproduce from run to run is neither noise nor a lack of fit.

    Args:
        fit: one session's share in a fit.
    """
    place, readings = fit.model.observations.place, fit.model.observations.readings
    count = np.bincount(place)
    free = int((count - 1).sum())
    declared = rms(fit.model.declared_sigma)
    squares, left = _of_its_own(fit)
    p_value = float(special.chdtrc(left, squares)) if left > _LEAST_LEFT else 1.0
    if free < priors.ENOUGH_REPEATS or len(count) > _MOST_PLACES:
        return Noise(declared, None, free, p_value, None)
    try:  # what other sessions say against this one is in none of its repeats
        alone = fit if len(fit.joint.assembly.models) == 1 else fit_models([fit.model]).fits[0]
    except ModelError:
        return Noise(declared, None, free, p_value, None, _as_read(fit))
    spread = [family.columns() * declared for family in reproducibility(fit.model.observations)]
    # Of every place, of one reading too, so that what no model explains there does not pass for noise; where so few
    # repeats would be left, of those read several times.
    for places in (np.arange(len(count)), np.flatnonzero(count > 1)):
        indicators = (place[None, :] == places[:, None]) * declared
        projected = screen(alone, np.concatenate([*spread, indicators]))
        scale = np.sqrt(np.maximum(projected.squares[:-1], np.finfo(float).tiny))
        inner, right = projected.gram[:-1, :-1] / np.outer(scale, scale), projected.gram[:-1, -1] / scale
        k = sum(len(columns) for columns in spread)
        explained_spread, rank_spread = _explained(inner[:k, :k], right[:k])
        explained_all, rank_all = _explained(inner, right)
        dof = alone.solution.degrees_of_freedom - rank_all
        if dof >= priors.ENOUGH_REPEATS and rank_all > rank_spread:
            break
    else:  # the model may be of the places themselves: then nothing is left to compare
        return Noise(declared, None, free, p_value, None, _as_read(fit))
    rounding = rounding_of(readings.displacement) / declared
    pure = max((alone.solution.chi_square - explained_all) / dof, rounding**2, 1e-12 / dof)
    lacking = max(explained_all - explained_spread, 0.0) / (rank_all - rank_spread)
    lack = float(special.fdtrc(rank_all - rank_spread, dof, lacking / pure))
    return Noise(declared, float(np.sqrt(pure)) * declared, round(dof), p_value, lack, _as_read(fit))


def pooled(every: Sequence[Noise], p_value: float) -> Noise:
    """That of several sessions with a common p-value, of which each counts by its repeats."""
    if len(every) == 1:
        return every[0]
    declared = rms(np.array([one.declared for one in every]))

    def together(name: Literal["from_repeats", "as_read"]) -> float | None:
        known = [(one.repeats, getattr(one, name) / one.declared) for one in every if getattr(one, name) is not None]
        weights, over = np.array(known).reshape(-1, 2).T
        return declared * float(np.sqrt(np.average(over**2, weights=weights))) if weights.any() else None

    repeats = sum(one.repeats for one in every)
    return Noise(declared, together("from_repeats"), repeats, p_value, None, together("as_read"))


def _of_its_own(fit: Fit) -> tuple[float, float]:
    """Sum of squares that the model leaves of a session's readings, and how many of them it leaves."""
    if len(fit.joint.assembly.models) == 1:
        return fit.solution.chi_square, fit.solution.degrees_of_freedom
    normalised = fit.joint.normalised(fit.index)
    return float(normalised @ normalised), float(np.sum(1.0 - leverage(fit)))


def _as_read(fit: Fit) -> float | None:
    """Standard deviation of readings about the mean of their place, m; see `Noise`."""
    observations = fit.model.observations
    place, values = observations.place, observations.readings.displacement
    if not spec_of(observations.session).reads_machine:
        return None
    count = np.bincount(place)
    about = values - means_of(place, values)
    return float(np.sqrt(about @ about / max(int((count - 1).sum()), 1)))


def rounding_of(values: Array) -> float:
    """Standard uncertainty by which readings (n,), m, are rounded: what is read to some digit scatters by the digit.

    All differences are multiples of the digit, which is the least of them, or a simple part of it; 0 where none is.
    """
    values = np.sort(values[np.isfinite(values)])
    off = values - values[:1]
    steps = np.diff(values)
    steps = steps[steps > _SAME_READING * np.ptp(values)] if len(values) else steps
    for part in range(1, _PARTS_OF_STEP + 1) if len(steps) else ():
        count = off / (steps.min() / part)
        if np.abs(count - np.round(count)).max() < _NEARLY_WHOLE:
            return float(steps.min() / part / np.sqrt(12.0))
    return 0.0


def _explained(inner: Array, right: Array) -> tuple[float, int]:
    """Squared norm that columns explain, and their rank, by a pivoted Cholesky decomposition."""
    if not inner.any():
        return 0.0, 0
    factor, pivots, rank, _ = linalg.lapack.dpstrf(inner, tol=1e-9, lower=1)
    along = linalg.solve_triangular(factor[:rank, :rank], right[pivots[:rank] - 1], lower=True)
    return float(along @ along), int(rank)
