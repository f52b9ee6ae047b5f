# SPDX-License-Identifier: Apache-2.0
"""What is known of the noise of the readings, and whether the model fits within it."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg, special

from machine_tool_calibration.arrays import Array, rms
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.model.fit import Fit, screen
from machine_tool_calibration.model.reproducibility import reproducibility
from machine_tool_calibration.session.catalogue import spec_of

# Fewer repeated readings than this say nothing of the noise; more places than this are not compared one by one.
FEWEST_REPEATS = 8
_MOST_PLACES = 1500
# Share of the range of the readings below which two of them are the same but for the computer's rounding.
_SAME_READING = 1e-9


@dataclass(frozen=True)
class Noise:
    """Noise of one reading, standard uncertainty in m."""

    declared: float  # what the session says
    # from readings repeated at the same place in the same setup, not less than what rounding them to the last digit
    # comes to; None without such
    from_repeats: float | None
    repeats: int  # degrees of freedom of the latter
    chi_square_p: float  # probability of so large residuals if the model is right and the declared uncertainty too
    # probability that places differ so much more than repeats at one place do (F test, with the spread between runs
    # subtracted from both); None without repeats
    lack_of_fit_p: float | None
    # what repeats of one place differ by as they were read, with all that differs from run to run; None without
    # repeats, and where each run counts from a zero of its own
    as_read: float | None = None

    def is_all(self, repeats: float | None, reduced_chi_square: float) -> bool:
        """Whether repeats, m, scatter as much as everything that a model with this reduced chi-square leaves."""
        scatter = np.sqrt(reduced_chi_square) * self.declared
        return repeats is not None and bool(repeats > priors.AS_NOISY * scatter)


def noise_of(fit: Fit) -> Noise:
    """Compare residuals with the declared uncertainty and with repeats.

    What does not reproduce from run to run is neither noise nor a lack of fit.

    Args:
        fit: one session's share in a fit.
    """
    place = fit.model.observations.place
    count = np.bincount(place)
    free = int((count - 1).sum())
    declared = rms(fit.model.sigma)
    if free < FEWEST_REPEATS or len(count) > _MOST_PLACES:
        return Noise(declared, None, free, fit.joint.p_value, None)
    spread = [family.columns() * declared for family in reproducibility(fit.model.observations)]
    # Of every place, of one reading too, so that what no model explains there does not pass for noise; where so few
    # repeats would be left, of those read several times.
    for places in (np.arange(len(count)), np.flatnonzero(count > 1)):
        indicators = (place[None, :] == places[:, None]) * declared
        projected = screen(fit, np.concatenate([*spread, indicators]))
        scale = np.sqrt(np.maximum(projected.squares[:-1], np.finfo(float).tiny))
        inner, right = projected.gram[:-1, :-1] / np.outer(scale, scale), projected.gram[:-1, -1] / scale
        total, k = float(projected.gram[-1, -1]), sum(len(columns) for columns in spread)
        explained_spread, rank_spread = _explained(inner[:k, :k], right[:k])
        explained_all, rank_all = _explained(inner, right)
        dof = fit.solution.degrees_of_freedom - rank_all
        if dof >= FEWEST_REPEATS and rank_all > rank_spread:
            break
    else:  # the model may be of the places themselves: then nothing is left to compare
        return Noise(declared, None, free, fit.joint.p_value, None, _as_read(fit))
    pure = max((total - explained_all) / dof, (_rounded_to(fit) / declared) ** 2 / 12.0, 1e-12 / dof)
    lacking = max(explained_all - explained_spread, 0.0) / (rank_all - rank_spread)
    lack = float(special.fdtrc(rank_all - rank_spread, dof, lacking / pure))
    return Noise(declared, float(np.sqrt(pure)) * declared, dof, fit.joint.p_value, lack, _as_read(fit))


def _as_read(fit: Fit) -> float | None:
    """Standard deviation of readings about the mean of their place, m; see `Noise`."""
    observations = fit.model.observations
    place, values = observations.place, observations.readings.displacement
    if not spec_of(observations.session).reads_machine:
        return None
    count = np.bincount(place)
    about = values - (np.bincount(place, values) / count)[place]
    return float(np.sqrt(about @ about / max(int((count - 1).sum()), 1)))


def _rounded_to(fit: Fit) -> float:
    """Least difference of readings, m: what is read to some digit repeats exactly, and scatters by the digit."""
    values = fit.model.observations.readings.displacement
    values = np.sort(values[np.isfinite(values)])
    steps = np.diff(values)
    steps = steps[steps > _SAME_READING * np.ptp(values)] if len(values) else steps
    return float(steps.min(initial=np.inf)) if len(steps) else 0.0


def _explained(inner: Array, right: Array) -> tuple[float, int]:
    """Squared norm that columns explain, and their rank, by a pivoted Cholesky decomposition."""
    if not inner.any():
        return 0.0, 0
    factor, pivots, rank, _ = linalg.lapack.dpstrf(inner, tol=1e-9, lower=1)
    along = linalg.solve_triangular(factor[:rank, :rank], right[pivots[:rank] - 1], lower=True)
    return float(along @ along), int(rank)
