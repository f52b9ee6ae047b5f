# SPDX-License-Identifier: Apache-2.0
"""Which readings stand beside each other: in a run, at a point, at a place."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, groups
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.session.session import Readings

__all__ = ["lasting", "near_of", "places_of", "runs_of"]

# Neighbours on one side in a run whose median says whether a deviation lasts, and the share of it that they must have.
_BESIDE = 3
_SHARED = 0.4


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


def lasting(run: tuple[IntArray, IntArray], suspected: IntArray, own: Array, residual: Array) -> BoolArray:
    """(k,) whether most of the neighbours on a side in the run share the deviation.

    Args:
        run: see `runs_of`.
        suspected: (k,) indices of the readings that deviate.
        own: (k,) their deviations.
        residual: (n,) of all readings.
    """
    out = np.zeros(len(suspected), dtype=bool)
    order, place = run
    n = len(order)
    position = np.empty(n, dtype=np.int64)
    position[order] = np.arange(n)
    at = position[suspected]
    for side in (-1, 1):
        near = at[:, None] + side * np.arange(1, _BESIDE + 1)
        inside = (near >= 0) & (near < n)
        near = np.clip(near, 0, n - 1)
        inside &= place[near] == place[at][:, None]
        # The lower one of the middle two where an end of the run leaves two: one of them may be wrong as well.
        alike = np.sort(np.where(inside, np.sign(own)[:, None] * residual[order[near]], np.inf), axis=1)
        count = inside.sum(axis=1)
        beside = alike[np.arange(len(at)), np.maximum(count - 1, 0) // 2]
        out |= (count > 1) & (beside > _SHARED * np.abs(own))
    return out
