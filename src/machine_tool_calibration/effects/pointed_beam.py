# SPDX-License-Identifier: Apache-2.0
"""A beam that is pointed at a retroreflector from a station: where there is one, and its angles."""

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.model.observations import Observations

POINTED_INSTRUMENTS = ("tracking_interferometer", "laser_tracker")
POINTED_METHODS = ("tracking_interferometer", "rotary_axis")


def cosine_of_elevation(observations: Observations) -> Array:
    """(n,) cosine of the beam's elevation."""
    return np.asarray(np.hypot(observations.direction[:, 0], observations.direction[:, 1]))


def is_open_loop(observations: Observations) -> bool:
    """Whether the beam stays on the commanded direction."""
    return getattr(observations.session.description, "pointing", "tracking") == "open_loop"
