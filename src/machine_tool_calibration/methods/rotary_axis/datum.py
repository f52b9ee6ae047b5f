# SPDX-License-Identifier: Apache-2.0
"""Datum of a rotary axis: its error motions relative to its axis average line (ISO 230-7), and what is left open.

Over a small angle a shift of a station looks like one of the datum and of smooth error motions. What the readings leave
open by more than a wide limit is held within it: a centimetre, or ten times the stated uncertainty if that is more.
Directions that the readings fix better are not touched, so over a large turn the stated places have no influence at
all, and a stated uncertainty that is far too small does no harm.
"""

from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, gaps_around
from machine_tool_calibration.estimation.solve import Linearised
from machine_tool_calibration.methods.rotary_axis.geometry import TableReadings
from machine_tool_calibration.model.model import Constraint, MethodModel, Prior, assemble
from machine_tool_calibration.words import say

ROTARY_DATUM = say("datum.rotary")
# Share of its largest singular value below which an angle's readings say nothing of a direction.
_LEAST_SINGULAR_VALUE = 1e-5
_FIXED = 1e-6


def unsensed_motions(table: TableReadings, direction: Array, arm: Array, size: float) -> Array:
    """(K, 6, 6) projectors onto the motions (translation, size times rotation) that no reading of an angle senses.

    From directions station to target and arms relative to the axis, each (n, 3); the zero matrix where all are
    sensed.
    """
    rows = np.concatenate([direction, np.cross(arm, direction) / size], axis=1)
    # A run with a single reading only says where its own zero is.
    counted = np.bincount(table.run)[table.run] > 1
    out = np.zeros((len(table.nodes), 6, 6))
    for k in range(len(table.nodes)):
        mine = rows[(table.node == k) & counted]
        values, vectors = np.linalg.eigh(mine.T @ mine)
        null = vectors[:, values <= _LEAST_SINGULAR_VALUE**2 * max(values[-1], 1e-300)]
        out[k] = null @ null.T
    return out


def open_directions(table: TableReadings) -> Array:
    """(6, K, 10) changes of the six tables that go unseen: six constants, and four that turn with the axis."""
    axis = "ABC".index(table.axis)
    across = [(axis + 1) % 3, (axis + 2) % 3]
    out = np.zeros((6, len(table.nodes), 10))
    for j in range(6):
        out[j, :, j] = 1.0
    for number, j in enumerate(across):
        out[:3, :, 6 + number] = table.node_rotation[:, :, j].T
        out[3:, :, 8 + number] = table.node_rotation[:, :, j].T
    return out


def motion_constraints(table: TableReadings, labels: list[list[str]], unsensed: Array, size: float) -> list[Constraint]:
    """No constants and nothing that turns with the axis, over the values (6, K labels) that the readings determine.

    Where no value of a motion is determined by itself (two targets: a turn about the line through them moves
    neither), the condition is put on what the readings do sense of the motion (`unsensed` and `size` as in
    `unsensed_motions`).
    """
    n = len(table.nodes)
    fixed: BoolArray = np.sqrt(np.einsum("kii->ik", unsensed).clip(0.0)) < _FIXED
    gauge = open_directions(table)
    rows = [(gauge * fixed[:, :, None]).reshape(6 * n, 10).T]
    _, s, vt = np.linalg.svd(rows[0].T, full_matrices=True)
    rank = int((s > 1e-9 * max(s.max(initial=0.0), 1.0)).sum())
    rest = gauge @ vt[rank:].T
    if rest.shape[2]:
        scale = np.repeat([1.0, size], 3)[:, None, None]
        rows.append((np.einsum("kij,jkg->ikg", np.eye(6) - unsensed, rest * scale) * scale).reshape(6 * n, -1).T)
    names = [label for row in labels for label in row]
    return [
        Constraint({name: float(w) for name, w in zip(names, row, strict=True) if w})
        for row in np.concatenate(rows)
        if np.abs(row).max() > 1e-12
    ]


def target_constraints(
    axis: Array, names: list[str], nominal: Array, reference: Array, seen: BoolArray
) -> list[Constraint]:
    """The targets (T, 3) that were seen together have their nominal height and angle about the axis."""
    out = []
    for field in (np.tile(axis, (len(nominal), 1)), np.cross(axis, nominal)):
        weights = field * seen[:, None]
        if np.abs(weights).max() > 1e-9:
            value = float(np.sum(weights * (nominal - reference)))
            out.append(Constraint({n: float(w) for n, w in zip(names, weights.ravel(), strict=True) if w}, value))
    return out


# Standard uncertainty with which an unseen motion is held at zero, m: wide against any error motion.
_HELD = 1e-4
# Part of a reading's standard uncertainty that what is unseen may add to an error motion.
_ADDED = 0.3


def unseen_motions(unsensed: Array, labels: Sequence[Sequence[str]], size: float) -> tuple[Prior, ...]:
    """Hold what is unseen at each angle (as in `unsensed_motions`) near zero, by the (6, K) names of the values."""
    scale = np.repeat([1.0, size], 3)
    out = []
    for k, projector in enumerate(unsensed):
        values, vectors = np.linalg.eigh(projector)
        for vector in vectors[:, values > 0.5].T:
            weights = {labels[j][k]: float(w) for j, w in enumerate(vector * scale) if w}
            out.append(Prior(weights, 0.0, _HELD))
    return tuple(out)


def unseen_names(unsensed: Array, labels: Sequence[Sequence[str]], sigma: float) -> frozenset[str]:
    """Names of the values that what is unseen could change by more than the readings' uncertainty sigma, m.

    Two targets at the same height leave open how the table tilts about the line through them, and hardly, because
    they are not quite at the same height, how it turns. An error motion counts as seen only if it is so wherever
    something is unseen: single values of one that comes and goes with the angle would mean nothing.
    """
    share = np.sqrt(np.einsum("kii->ik", unsensed).clip(0.0))
    open_ = share.max(axis=0, initial=0.0) > 0
    hidden = share.max(axis=1, initial=0.0) > _ADDED * sigma / _HELD
    return frozenset(labels[j][k] for j in np.flatnonzero(hidden).tolist() for k in np.flatnonzero(open_).tolist())


HELD_WITHIN = 0.01
"""Least standard uncertainty with which first estimates are trusted where the readings are silent, m."""
_OPEN_SHARE = 1e-3  # of a direction that is not determined in the places


def covered_angle(table: TableReadings) -> float:
    """Turn that the read angles cover, rad: a full turn less the largest gap."""
    return float(2 * np.pi - gaps_around(table.nodes[np.unique(table.node)])[1].max())


def weak_places(model: MethodModel, names: list[str], nominal: Array, within: float) -> tuple[Prior, ...]:
    """Directions of places (k names, stated values, m) that the readings fix worse than `within`, m, held within it."""
    assembly = assemble([model])
    normal = Linearised.at(assembly.problem, *assembly.problem.zero).normal()
    place = {parameter.name: k for k, parameter in enumerate(assembly.parameters)}
    index = np.array([place[name] for name in names])
    spread: Array = normal.covariance[np.ix_(index, index)]
    open_ = normal.undetermined[index]
    open_ = open_[:, np.linalg.norm(open_, axis=0) > _OPEN_SHARE]
    # An undetermined direction is as uncertain as you like: a kilometre will do.
    values, vectors = np.linalg.eigh(spread + 1e6 * open_ @ open_.T)
    away = nominal - np.array([assembly.parameters[k].reference for k in index])
    return tuple(
        Prior({name: float(w) for name, w in zip(names, vector, strict=True)}, float(vector @ away), within)
        for vector in vectors.T[values > within**2]
    )
