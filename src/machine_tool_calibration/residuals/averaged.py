# SPDX-License-Identifier: Apache-2.0
"""Readings of the same places, averaged: what was drilled once and measured often shows the machine once."""

from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.reproducibility import Family
from machine_tool_calibration.residuals.noise import Noise, noise_of
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.session import Session

# Places that were read again, of which a random constant of each is told from what all have in common; and at most.
_FEWEST, _MOST = 4, 100


def _of_an_area(observations: Observations) -> bool:
    """Whether direct deviations of places along two axes or more were read."""
    return spec_of(observations.session).reads_machine and observations.moved.sum() >= 2


def own_of_places(fit: Fit) -> tuple[Family, ...]:
    """What each place has for itself, as a random constant, where places along two axes were read again.

    In another setup, too: by what the same place differs runs and setups do, and not by what no model has of a part.
    """
    observations = fit.model.observations
    if not _of_an_area(observations):
        return ()
    place = observations.readings.alike(setup=False, approach=False)
    again = np.bincount(place)[place] > 1
    if not _FEWEST <= len(np.unique(place[again])) <= _MOST:
        return ()
    return (Family("place", np.where(again, place, 0), again[None].astype(float)),)


def mean_places(fit: Fit) -> tuple[Session, Noise] | None:
    """The session with the mean of the readings of each place, where these differ by more than their repeats do.

    A hole that was drilled once and measured five times shows the machine once: so it is where places differ along at
    least two axes. The readings of a single axis are the machine's own, run after run. With it what repeats say of the
    noise, beside a model without further effects; None where places do not differ, nothing says so, or so few are left
    beside the model's unknowns that a further effect would explain any means.
    """
    observations = fit.model.observations
    session, readings, place = observations.session, observations.readings, observations.place
    count = np.bincount(place)
    spare = len(count) + fit.solution.degrees_of_freedom - len(observations)
    if spare < priors.ENOUGH_PLACES or not _of_an_area(observations) or count.max() < 2:
        return None
    noise = noise_of(fit)
    if noise.lack_of_fit_p is None or noise.lack_of_fit_p > priors.LACK_OF_FIT_P:
        return None
    first = np.unique(place, return_index=True)[1]

    def mean(values: Array) -> Array:
        # Differences from the first: what is the same for all stays the same to the last bit.
        return np.asarray(values[first] + (np.bincount(place, values - values[first][place]) / count)[place[first]])

    averaged = readings.select(first)
    averaged = replace(
        averaged,
        displacement=mean(readings.displacement),
        columns={name: mean(values) for name, values in readings.columns.items()},
    )
    order = np.argsort(averaged.row, kind="stable")
    return session.with_readings(averaged.select(order)), noise
