"""The plan of any method."""

from __future__ import annotations

from typing import Annotated, Any, Union

import numpy as np
from pydantic import Field

from machine_tool_calibration.simulation.environment import Environment
from machine_tool_calibration.simulation.measurement import Measurement
from machine_tool_calibration.simulation.tracking_run import TrackingPlan, plan_tracking

__all__ = ["AnyPlan", "measure"]

AnyPlan = Annotated[Union[TrackingPlan], Field()]

_MEASURE: dict[type, Any] = {TrackingPlan: plan_tracking}


def measure(plan: AnyPlan, environment: Environment, rng: np.random.Generator) -> Measurement:
    """The measurement of a plan; `rng` decides where the instrument truly stands."""
    measurement: Measurement = _MEASURE[type(plan)](plan, environment, rng)
    return measurement
