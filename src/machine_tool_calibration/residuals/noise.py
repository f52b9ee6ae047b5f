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
from machine_tool_calibration.model.rounding import rounding_of
from machine_tool_calibration.residuals.leverage import leverage
from machine_tool_calibration.session.catalogue import spec_of

# More places than this are not compared one by one.
_MOST_PLACES = 1500
# Readings that a model leaves of a session, below which it leaves none.
_LEAST_LEFT = 1e-6
# Share of a column's squares outside the model below which that is rounding.
_NOTHING_LEFT = 1e-9


@dataclass(frozen=True)
class Noise:
    """Noise of one reading, standard uncertainty in m."""

    declared: float  # what the session says
    counted: float  # by what readings count: by their rounding or noise of their own, where that is more
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
    of_places: float = 0.0  # share of what the model leaves that is of the places, beside what runs differ by

    def is_all(self, repeats: float | None, reduced_chi_square: float, share: float = priors.AS_NOISY) -> bool:
        """Whether repeats, m, scatter as much as this share of what a model with this reduced chi-square leaves."""
        scatter = np.sqrt(reduced_chi_square) * self.declared
        return repeats is not None and bool(repeats > share * scatter)


def noise_of(fit: Fit) -> Noise:
    """Compare residuals of a session with the declared uncertainty and with repeats.

    What does not reproduce from run to run is neither noise nor a lack of fit.
    """
    place, readings = fit.model.observations.place, fit.model.observations.readings
    count = np.bincount(place)
    free = int((count - 1).sum())
    declared = rms(fit.model.declared_sigma)
    counted = rms(fit.model.sigma)
    squares, left = _of_its_own(fit)
    p_value = float(special.chdtrc(left, squares)) if left > _LEAST_LEFT else 1.0
    if free < priors.ENOUGH_REPEATS or len(count) > _MOST_PLACES:
        return Noise(declared, counted, None, free, p_value, None)
    try:  # what other sessions say against this one is in none of its repeats
        alone = fit if len(fit.joint.assembly.models) == 1 else fit_models([fit.model]).fits[0]
    except ModelError:
        return Noise(declared, counted, None, free, p_value, None, _as_read(fit))
    spread = [family.columns() * counted for family in reproducibility(fit.model.observations)]
    # Of every place, of one reading too, so that what no model explains there does not pass for noise; where so few
    # repeats would be left, of those read several times.
    for places in (np.arange(len(count)), np.flatnonzero(count > 1)):
        indicators = (place[None, :] == places[:, None]) * counted
        projected = screen(alone, np.concatenate([*spread, indicators]))
        scale = np.sqrt(np.maximum(projected.squares[:-1], np.finfo(float).tiny))
        inner, right = projected.gram[:-1, :-1] / np.outer(scale, scale), projected.gram[:-1, -1] / scale
        k = sum(len(columns) for columns in spread)
        explained_spread, rank_spread = _explained(inner[:k, :k], right[:k])
        explained_all, rank_all = _explained(inner, right)
        dof = alone.solution.degrees_of_freedom - rank_all
        if dof >= priors.ENOUGH_REPEATS:
            break
    else:
        return Noise(declared, counted, None, free, p_value, None, _as_read(fit))
    rounding = rounding_of(readings.displacement) / counted
    pure = max((alone.solution.chi_square - explained_all) / dof, rounding**2, 1e-12 / dof)
    lacking, more = max(explained_all - explained_spread, 0.0), rank_all - rank_spread
    # A model of the places themselves lacks nothing of them.
    lack = float(special.fdtrc(more, dof, lacking / more / pure)) if more else None
    share = lacking / max(alone.solution.chi_square, np.finfo(float).tiny)
    return Noise(declared, counted, float(np.sqrt(pure)) * counted, round(dof), p_value, lack, _as_read(fit), share)


def pooled(every: Sequence[Noise], p_value: float) -> Noise:
    """That of several sessions with a common p-value, of which each counts by its repeats."""
    if len(every) == 1:
        return every[0]
    declared, counted = (rms(np.array([getattr(one, name) for one in every])) for name in ("declared", "counted"))

    def together(name: Literal["from_repeats", "as_read"]) -> float | None:
        known = [(one.repeats, getattr(one, name) / one.declared) for one in every if getattr(one, name) is not None]
        weights, over = np.array(known).reshape(-1, 2).T
        return declared * float(np.sqrt(np.average(over**2, weights=weights))) if weights.any() else None

    repeats = sum(one.repeats for one in every)
    return Noise(declared, counted, together("from_repeats"), repeats, p_value, None, together("as_read"))


def scatter_over_declared(fit: Fit) -> float | None:
    """How many times as much as declared a session's readings scatter; None where the model leaves none of them."""
    squares, left = _of_its_own(fit)
    return float(np.sqrt(squares / left)) if left > _LEAST_LEFT else None


def _of_its_own(fit: Fit) -> tuple[float, float]:
    """Sum of squares, over those declared, that the model leaves of a session, and how many readings it leaves."""
    if len(fit.joint.assembly.models) == 1:
        dof = fit.solution.degrees_of_freedom
        return dof * fit.joint.reduced_chi_square, dof
    over = fit.residuals / fit.model.declared_sigma
    return float(over @ over), float(np.sum(1.0 - leverage(fit)))


def _as_read(fit: Fit) -> float | None:
    """Standard deviation of readings about the mean of their place, m; see `Noise`."""
    observations = fit.model.observations
    place, values = observations.place, observations.readings.displacement
    if not spec_of(observations.session).reads_machine:
        return None
    count = np.bincount(place)
    about = values - means_of(place, values)
    return float(np.sqrt(about @ about / max(int((count - 1).sum()), 1)))


def _explained(inner: Array, right: Array) -> tuple[float, int]:
    """Squared norm that columns explain, and their rank, by a pivoted Cholesky decomposition."""
    if inner.diagonal().max(initial=0.0) <= _NOTHING_LEFT:  # LAPACK does not hold the first pivot against it
        return 0.0, 0
    factor, pivots, rank, _ = linalg.lapack.dpstrf(inner, tol=_NOTHING_LEFT, lower=1)
    along = linalg.solve_triangular(factor[:rank, :rank], right[pivots[:rank] - 1], lower=True)
    return float(along @ along), int(rank)
