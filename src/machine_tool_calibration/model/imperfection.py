# SPDX-License-Identifier: Apache-2.0
"""What every model lacks a little: smooth functions of where a reading was taken.

No model of a real machine is exactly true. What it misses is mostly smooth in place and small; were it not part of the
comparison, the effect of the catalogue that comes nearest to it would seem to be its cause.
"""

from itertools import combinations

import numpy as np
from scipy.special import softmax

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.estimation.marginal import Gram, marginal_at
from machine_tool_calibration.model.observations import Observations, azimuth
from machine_tool_calibration.session.catalogue import spec_of

IMPERFECT = "imperfection"
"""Name of the family of smooth functions that no model has."""

# Highest degree of a coordinate, and of a product of two; highest order of a wave in an angle.
_DEGREE, _TOGETHER, _ORDER = 4, 3, 4


def imperfection(observations: Observations) -> Array:
    """(k, n) smooth functions of place, whose sum has about the size 1 if each coefficient is of size 1.

    Legendre polynomials of the coordinates that vary, products of two of them, and waves in the angles. None where the
    machine's errors are read themselves: there a smooth function of place is an error motion, and to be named.
    """
    if spec_of(observations.session).reads_machine:
        return np.zeros((0, len(observations)))
    place = {a: v for a, v in zip("xyz", observations.position.T, strict=True)}
    within = {a: s for a, s in ((a, scaled_values(v)) for a, v in place.items()) if s is not None}
    series = {a: np.polynomial.legendre.legvander(s, _DEGREE).T for a, s in within.items()}
    out = [values[d] / d for values in series.values() for d in range(1, _DEGREE + 1)]
    for a, b in combinations(series, 2):
        degrees = [(i, j) for i in range(1, _TOGETHER) for j in range(1, _TOGETHER) if i + j <= _TOGETHER]
        out += [series[a][i] * series[b][j] / (i + j) for i, j in degrees]
    for angle in _angles(observations):
        out += [wave(k * angle) / k for k in range(1, _ORDER + 1) for wave in (np.sin, np.cos)]
    if not out:
        return np.zeros((0, len(observations)))
    columns = np.array(out)
    whole = np.sqrt(np.mean(np.sum(columns**2, axis=0)))
    return np.asarray(columns / max(float(whole), 1e-300))


def _angles(observations: Observations) -> list[Array]:
    columns = observations.readings.columns
    angles = [columns[axis] for axis in "abc" if axis in columns]
    spec = spec_of(observations.session)
    if spec.beam_from_pointer:
        angles.append(azimuth(observations.direction))
    if spec.probes_surface:
        angles.append(azimuth(observations.table_direction))
    return [angle for angle in angles if np.ptp(angle) > 0]


def misfit(projected: Array, order: IntArray, own: IntArray, ratio: tuple[float, ...], dof: int) -> float:
    """Root mean square of the size of what every model lacks a little, in units of what readings scatter by beside it.

    Args:
        projected: (u + 1, u + 1) inner products of all functions with the residual, outside the model.
        order: (u,) the functions of runs, then those of what a model lacks.
        own: family of each of the former.
        ratio: size of each family, in units of the noise.
        dof: degrees of freedom of the readings beside the model's unknowns.
    """
    inner, data = projected[np.ix_(order, order)], projected[order, -1]
    family = np.append(own, np.full(len(order) - len(own), len(ratio)))
    gram = Gram(inner, data, float(projected[-1, -1]), family, dof)
    sizes, shares = np.array(list(priors.IMPERFECTION_SIZES.items())).T
    ratios = np.column_stack([np.tile(ratio, (len(sizes), 1)), sizes])
    return float(np.sqrt(softmax(marginal_at(gram, ratios, np.log(shares)).log_null) @ sizes**2))


def scaled_values(values: Array) -> Array | None:
    """Values from -1 to 1; None where it does not vary or has gaps."""
    if not len(values) or not np.isfinite(values).all():
        return None
    middle, half = (values.max() + values.min()) / 2, np.ptp(values) / 2
    if half <= 1e-9 * max(abs(middle), 1e-9):
        return None
    return np.asarray((values - middle) / half)
