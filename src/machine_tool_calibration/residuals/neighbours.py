# SPDX-License-Identifier: Apache-2.0
"""Which readings stand beside each other: in a run, at a point, at a place."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import IntArray, groups
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.session.session import Readings

__all__ = ["near_of", "places_of", "runs_of"]


def runs_of(model: MethodModel) -> tuple[IntArray, IntArray]:
    """Order of the readings run by run, and the run of each in that order."""
    readings = model.observations.readings
    others = [readings.labels["target"]] if "target" in readings.labels else []
    # Deviations of a place along x and along y stand beside each other, and are two runs.
    others += [np.round(readings.columns[name], 6) for name in ("gx", "gy", "gz") if name in readings.columns]
    run = groups(readings.repeat, readings.setup, *others)
    order = np.argsort(run, kind="stable")
    return order, run[order]


def near_of(part: Part, readings: Readings) -> IntArray:
    """(n,) index shared by readings of one point of the model, or of one place where it has none."""
    return part.point_of_reading() if part.dimension else places_of(readings)


def places_of(readings: Readings) -> IntArray:
    """(n,) index shared by readings that repeat each other, whatever the direction of approach."""
    places = [np.round(readings.columns[a] * 1e9) for a in ("x", "y", "z", "c") if a in readings.columns]
    senses = [np.round(readings.columns[a] * 1e6) for a in ("gx", "gy", "gz") if a in readings.columns]
    return groups(readings.setup, *places, *senses, *readings.labels.values())
