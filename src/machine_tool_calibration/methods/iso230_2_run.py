"""Which setups of a session are runs by ISO 230-2, and their figures."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.methods.iso230_2 import positioning, positioning_uncertainty
from machine_tool_calibration.model.observations import Observations

__all__ = ["positioning_runs"]

_ALONG = 0.9999  # cosine between the direction that is read and the axis
_STILL = 1e-6  # m
_SAME = 1e-5  # m: commanded positions that are one target


def positioning_runs(observations: Observations) -> list[dict[str, Any]]:
    """Figures of every setup in which one linear axis was read along itself, in both directions or repeatedly.

    Returns:
        For each such setup its id, the axis, the fields of `iso230_2.Positioning`, and the expanded
        uncertainties (k = 2) of its figures, `B_U` and so on, as far as the runs tell them.
    """
    out = []
    for index, name in enumerate(observations.session.setup_ids):
        mine = np.flatnonzero(observations.readings.setup == index)
        axis = _axis_read(observations, mine)
        if axis is None:
            continue
        position, direction = _approach(observations, mine, axis)
        if len(np.unique(position)) < 2 or (abs(direction.sum()) == len(mine) and _single(position)):
            continue
        sense = observations.direction[mine, axis]
        deviation = observations.readings.displacement[mine] * np.sign(sense)
        figures = positioning(position, direction, deviation)
        expanded = {f"{key}_U": value for key, value in positioning_uncertainty(figures).items()}
        told = {"setup": name, "axis": "XYZ"[axis], **asdict(figures), **expanded}
        if expanded:
            told["note"] = "U is from the repeatability of the runs alone; that of the instrument comes on top."
        out.append(told)
    return out


def _axis_read(observations: Observations, mine: IntArray) -> int | None:
    """The axis along which all readings sense, if it alone moves."""
    if len(mine) < 4:
        return None
    moved = np.ptp(observations.position[mine], axis=0) > _STILL
    along = np.abs(observations.direction[mine]).min(axis=0) > _ALONG
    if moved.sum() != 1 or not along[int(np.argmax(moved))]:
        return None
    return int(np.argmax(moved))


def _approach(observations: Observations, mine: IntArray, axis: int) -> tuple[Array, Array]:
    """Target positions, those within a hair made equal, and signs of approach."""
    place = observations.position[mine, axis]
    order = np.argsort(place, kind="stable")
    step = np.r_[0, np.cumsum(np.diff(place[order]) > _SAME)]
    group = np.empty(len(place), dtype=np.int64)
    group[order] = step
    target = (np.bincount(group, place) / np.bincount(group))[group]
    recorded = observations.readings.columns.get(f"dir_{'xyz'[axis]}")
    if recorded is not None and np.isin(recorded[mine], (-1.0, 1.0)).all():
        return target, recorded[mine]
    # Without it: the sign of the move to the reading; the second reading at a turning point comes from beyond.
    move = np.sign(np.diff(group, prepend=group[0] - 1))
    for k in np.flatnonzero(move == 0):
        following = np.flatnonzero(np.diff(group[k:]) != 0)
        move[k] = np.sign(group[k + 1 + following[0]] - group[k]) if len(following) else -move[k - 1]
    return target, move.astype(float)


def _single(position: Array) -> bool:
    """Whether no position was read twice."""
    return bool(np.unique(position, return_counts=True)[1].max() < 2)
