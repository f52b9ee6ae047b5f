# SPDX-License-Identifier: Apache-2.0
"""Readings of the same places, averaged: what was drilled once and measured often shows the machine once."""

from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.observations import SAME_POSITION
from machine_tool_calibration.residuals.noise import Noise, noise_of
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.session import Session


def mean_places(fit: Fit) -> tuple[Session, Noise] | None:
    """The session with the mean of the readings of each place, and what its repeats say of the noise.

    A hole that was drilled once and measured five times shows the machine once. Averaged are direct deviations whose
    places differ along at least two axes and by more than their repeats do; the readings of a single axis are the
    machine's own, run after run.

    Args:
        fit: of the model without further effects.

    Returns:
        None where nothing is to be averaged.
    """
    observations = fit.model.observations
    session, readings = observations.session, observations.readings
    if not spec_of(session).reads_machine or (np.ptp(observations.position, axis=0) > SAME_POSITION).sum() < 2:
        return None
    place = observations.place
    count = np.bincount(place)
    if count.max() < 2:
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
