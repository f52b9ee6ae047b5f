# SPDX-License-Identifier: Apache-2.0
"""What a model leaves at a place: whether it is that of the places beside it, and of every setup."""

from collections.abc import Sequence

import numpy as np
from scipy import spatial, special

from machine_tool_calibration.arrays import Array, IntArray, groups, means_of
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.observations import SAME_POSITION, Observations
from machine_tool_calibration.session.catalogue import spec_of

# Fewer places than this have no pattern, and more than this are not compared; nearest places per axis that moved.
_FEWEST_PLACES, _MOST_PLACES, _NEAREST = 12, 1500, 2
# Setups in the mean that read a place, from which they tell what it has for itself.
_SEVERAL = 1.5
# Share of their squares from which what places differ by is of setups.
_MOST_OF_THEM = 0.5


def alike_beside_p(fit: Fit) -> float | None:
    """Probability that places next to each other are left so much alike if there is no pattern: Moran's I.

    Places are compared by the mean of their readings' residuals, with those that were read in the same setup, along the
    same direction and approached from the same side. None where too few places were read.
    """
    observations = fit.model.observations
    columns, place = observations.readings.columns, observations.place
    first = np.unique(place, return_index=True)[1]
    mean = means_of(place, fit.residuals)[first]
    if not _FEWEST_PLACES <= len(first) <= _MOST_PLACES:
        return None
    seen = [np.round(along * 1e6) for along in observations.direction[first].T]
    seen += [columns[name][first] for name in (f"dir_{axis}" for axis in "xyzabc") if name in columns]
    kind = groups(observations.readings.setup[first], *seen)
    where = observations.position[first]
    mean = mean - means_of(kind, mean)
    pairs = _beside(where, kind, _NEAREST * int((np.ptp(where, axis=0) > SAME_POSITION).sum()))
    if not pairs.any() or not mean.any():
        return None
    return float(special.ndtr(-_moran(mean, pairs)))


def read_in_several_setups(observations: Observations) -> bool:
    """Whether a machine's own deviations were read at the same places in several setups: most of them."""
    seen, own = (observations.readings.alike(setup=each, approach=False) for each in (False, True))
    return spec_of(observations.session).reads_machine and _SEVERAL * (seen.max() + 1) < own.max() + 1


def differ_by_setup(fits: Sequence[Fit]) -> bool:
    """Whether most of what places differ by is what each of them differs by from setup to setup."""
    between = of_setups = 0.0
    for own in fits:
        seen, residual = own.model.observations, own.residuals
        at = groups(*seen.position.T, *seen.direction.T)
        state = groups(at, seen.readings.setup)
        whole, each = means_of(at, residual), means_of(state, residual)
        between, of_setups = between + float(each @ each), of_setups + float((each - whole) @ (each - whole))
    return of_setups > _MOST_OF_THEM * between


def _beside(where: Array, kind: IntArray, count: int) -> Array:
    """(n, n) 1 for the nearest places of the same kind, else 0."""
    pairs = np.zeros((len(where), len(where)))
    for k in np.unique(kind):
        mine = np.flatnonzero(kind == k)
        if len(mine) > count > 0:
            near = np.asarray(spatial.KDTree(where[mine]).query(where[mine], count + 1)[1])[:, 1:]
            pairs[mine[:, None], mine[near]] = 1.0
    return pairs


def _moran(values: Array, pairs: Array) -> float:
    """Moran's I of values (n,) in standard deviations of what it is without a pattern (Cliff and Ord 1981)."""
    n, total = len(values), pairs.sum()
    found = n / total * (values @ pairs @ values) / (values @ values)
    both = 0.5 * np.sum((pairs + pairs.T) ** 2)
    ends = np.sum((pairs.sum(axis=0) + pairs.sum(axis=1)) ** 2)
    expected = -1.0 / (n - 1)
    variance = (n**2 * both - n * ends + 3.0 * total**2) / (total**2 * (n**2 - 1.0)) - expected**2
    return float((found - expected) / np.sqrt(variance))
