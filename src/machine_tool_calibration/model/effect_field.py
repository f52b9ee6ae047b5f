"""Where an effect moves the functional point, for maps of position errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.model.observations import Observations

__all__ = ["displacement_field"]


def displacement_field(
    effect: Effect, observations: Observations, evaluate: Callable[[Observations], Array]
) -> Array | None:
    """Displacement of the functional point per unit of each of an effect's unknowns.

    Args:
        effect: the effect.
        observations: the readings.
        evaluate: (k, n) columns of the effect's unknowns for other observations.

    Returns:
        (k, n, 3), found by looking at the same readings along each axis; None for an effect on the reading itself, and
        for methods whose map holds no effects.
    """
    if effect.kind != "position" or observations.session.method != "direct":
        return None
    looks = [replace(observations, direction=np.tile(np.eye(3)[j], (len(observations), 1))) for j in range(3)]
    return np.stack([evaluate(look) for look in looks], axis=-1)
