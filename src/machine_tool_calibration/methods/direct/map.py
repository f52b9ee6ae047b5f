# SPDX-License-Identifier: Apache-2.0
"""What a fit of direct deviations says: position errors, tables, and the figures of ISO 230-2 runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, rigid_motions, rms
from machine_tool_calibration.methods.direct.datum import SetupDatum
from machine_tool_calibration.methods.direct.iso230_2 import positioning, positioning_uncertainty
from machine_tool_calibration.methods.direct.model import DirectModel
from machine_tool_calibration.methods.direct.plate import plate_steps
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.model.rigid_body import (
    MachineTable,
    determined_part,
    map_field,
    position_errors,
    tables_content,
)

__all__ = ["error_map", "positioning_runs", "sensed_axes"]


_ALONG = 0.9999  # cosine between the direction that is read and the axis
_STILL = 1e-6  # m
_SAME = 1e-5  # m: commanded positions that are one target


def positioning_runs(observations: Observations, *, uncertain: bool = True) -> list[dict[str, Any]]:
    """Figures of every setup in which one linear axis was read along itself, in both directions or repeatedly.

    Args:
        observations: the readings.
        uncertain: whether the uncertainties of the figures are wanted, which take most of the time.

    Returns:
        For each such setup its id, the axis, the fields of `iso230_2.Positioning`, and the expanded
        uncertainties (k = 2) of its figures, `B_U` and so on, as far as the runs determine them.
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
        uncertainties = positioning_uncertainty(figures) if uncertain else {}
        expanded = {f"{key}_U": value for key, value in uncertainties.items()}
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


_LOOSE = 1e-9
# Component of a unit direction below which a reading does not sense an axis: a beam that is a little off it.
_ACROSS = 1e-2


def sensed_axes(direction: Array) -> BoolArray:
    """(3,) which machine axes any of the unit directions (n, 3) has a component along."""
    return np.asarray(np.abs(direction).max(axis=0, initial=0.0) > _ACROSS)


def error_map(model: DirectModel, fit: Fit) -> ErrorMap:
    """The contract's content for `direct`.

    What the setups' unknowns leave open is taken out of the position errors by least squares over the points, so that
    neither the errors nor their uncertainties hinge on a single node. A direction that no reading senses is NaN
    everywhere: a term or an effect may move it, but nothing was measured there.
    """
    observations, tables, setups = model.observations, model.tables, model.setups
    own, n = len(setups.parameters), len(observations)
    fields = [map_field(tables, observations.position)]
    # Terms of added effects follow those of the tables; of them only displacements count.
    for term in model.terms[len(tables) :]:
        size = len(term.parameters)
        fields.append(np.zeros((size, n, 3)) if term.field is None else term.field)
    # What is not sensed has no part in the map's least squares, and distinguishes no states of an effect.
    sensed = sensed_axes(observations.direction)
    fields = [one * sensed for one in fields]
    field = np.concatenate(fields)
    first = _states(observations.position, np.concatenate([np.zeros((0, n, 3)), *fields[1:]]))
    points, field = observations.position[first], field[:, first]
    flat = field.reshape(len(field), 3 * len(points))
    mine = slice(own, own + len(field))
    common = _common(flat[: len(fields[0])].T @ model.fixed[own:], setups, points, observations.direction)
    if common.shape[1]:
        flat = flat - (common @ np.linalg.lstsq(common, flat.T, rcond=1e-9)[0]).T
    parts = flat.reshape(len(field), len(points), 3)
    error, covariance = position_errors(parts, fit.theta[mine], fit.covariance[mine, mine])
    loose = np.linalg.norm(flat.T @ fit.solution.loose_directions()[fit.places][mine], axis=1).reshape(-1, 3) > _LOOSE
    error, uncertainty, covariance = determined_part(error, covariance, loose | ~sensed)
    content: dict[str, Any] = {
        "points": points,
        "position_error": error,
        "position_error_u": uncertainty,
        "tables": _tables(tables, fit, own),
        "spread_over_declared": float(np.sqrt(fit.joint.reduced_chi_square)),
        "scatter": _scatter(observations, fit),
        "datum": _words(setups, bool(common.shape[1])),
    }
    # These are of the readings themselves: a restated fit changes nothing of them.
    if fit.joint.given is None:
        runs, steps = positioning_runs(observations), plate_steps(observations, setups)
        content |= {"iso230_2": runs} if runs else {}
        content |= {} if steps is None else {"plate": steps}
    return ErrorMap(content, points, error, uncertainty, covariance)


def _scatter(observations: Observations, fit: Fit) -> dict[str, Any]:
    """What the readings scatter about the model, what was declared, and on which the standard uncertainties rest."""
    sigma, ratio = fit.model.sigma, float(np.sqrt(fit.joint.reduced_chi_square))
    declared = rms(sigma) if np.ptp(sigma) > 0 else observations.session.sigma
    return {
        "declared": declared,
        "found": ratio * declared,
        "uncertainties_from": "scatter" if fit.scatter_factor > 1.0 else "declared",
        "factor": fit.scatter_factor,
    }


def _words(setups: SetupDatum, reduced: bool) -> str:
    what = {"none": "the tables share", "offset": "the offsets leave open", "rigid": "shifts and turns leave open"}[
        setups.kind
    ]
    if not reduced:
        return setups.words
    return f"position errors hold nothing of what {what} (least squares over the points)"


def _common(tables: Array, setups: SetupDatum, points: Array, direction: Array) -> Array:
    """(3 n, q) displacements of all points that the setups' unknowns leave open, of unit size.

    Directions that no reading senses are left out. Beside what the tables can follow, these are shift and turn of
    everything; with offsets, a shift along the direction that was read, if there is only one.
    """
    n = len(points)
    parts = [tables]
    if setups.kind == "rigid":
        moved = rigid_motions(points - points.mean(axis=0))
        parts.append((moved * sensed_axes(direction)[:, None]).reshape(3 * n, 6))
    elif setups.kind == "offset" and np.allclose(np.abs(direction @ direction[0]), 1.0, atol=1e-9):
        parts.append(np.tile(direction[0] * sensed_axes(direction), n)[:, None])
    common = np.concatenate(parts, axis=1)
    size = np.linalg.norm(common, axis=0)
    return np.asarray(common[:, size > 1e-9] / size[size > 1e-9])


def _states(position: Array, field: Array) -> IntArray:
    """The first reading of each position, once for every different state of the effects there."""
    key = np.concatenate([np.round(position * 1e9), field.transpose(1, 0, 2).reshape(len(position), -1)], axis=1)
    return np.sort(np.unique(key, axis=0, return_index=True)[1])


def _tables(tables: Sequence[MachineTable], fit: Fit, first: int) -> dict[str, Any]:
    """Nodes, values and uncertainties of each error motion; value and uncertainty of a squareness."""
    sigma = np.sqrt(np.diag(fit.covariance).clip(0.0))
    theta, sigma = np.where(fit.determined, fit.theta, np.nan), np.where(fit.determined, sigma, np.nan)
    return tables_content(tables, theta[first:], sigma[first:])
