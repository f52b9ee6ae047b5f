# SPDX-License-Identifier: Apache-2.0
"""The machine's position errors in the states in which readings met it: with what effects add to the tables' errors.

A map of most methods is of the machine's tables alone. Backlash, thermal expansion and the like displace the functional
point too, each reading by its own direction of approach, temperature, time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.effects.effect_terms import shape_of
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import Kind
from machine_tool_calibration.model.observations import Observations, first_states
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.session.catalogue import spec_of

# Displacements that differ by less are the same state; distances that do are the same place, m.
_SAME_STATE = 1e-10
_PLACE = 1e-7


@dataclass(frozen=True)
class ErrorStates:
    """Position errors, one row for each state of the machine at each point of a map."""

    error_map: ErrorMap  # points, errors and uncertainties; a point stands in it once for every state
    directions: Array  # (n, 3) signs of the last moves of x, y, z; 0 where they were not recorded
    effects: tuple[str, ...]  # ids of the effects in the model that displace the functional point


def error_states(error_map: ErrorMap, fits: Sequence[Fit], effects: Sequence[Effect]) -> ErrorStates:
    """Errors of the map with those of the effects, as in the readings that are nearest to each of its points.

    Where the direction of approach matters, each point has the nearest readings of every direction that occurred:
    it may be reached from either side, whether it was in the measurement or not. Effects on the reading itself are
    no errors of the machine and do not count.
    """
    terms = {term.name for fit in fits for term in fit.model.terms}
    acting = [effect for effect in effects if effect.kind == "position" and effect.id in terms]
    names = tuple(effect.id for effect in acting)
    observed = [fit.model.observations for fit in fits]
    approach = np.concatenate([_directions(o) for o in observed])
    if not acting or not len(error_map.points):
        return ErrorStates(error_map, np.zeros_like(error_map.points), names)
    added = np.concatenate([sum((displacement(e, fit) for e in acting), np.zeros((1, 3))) for fit in fits])
    if len(observed) == 1 and spec_of(observed[0].session).reads_machine:
        # This map holds the effects, once for every state.
        readings = _mapped(fits[0], names)
        if len(readings) == len(error_map.points):
            return ErrorStates(error_map, approach[readings], names)
    approach = approach * [any(f"dir_{axis}" in effect.needs for effect in acting) for axis in "xyz"]
    rows, readings = _nearest(error_map.points, np.concatenate([o.position for o in observed]), approach)
    state = np.round(np.concatenate([added, approach], axis=1)[readings] / _SAME_STATE)
    first = np.sort(np.unique(np.column_stack([rows, state]), axis=0, return_index=True)[1])
    rows, readings = rows[first], readings[first]
    points, error, u = error_map.points[rows], error_map.error[rows] + added[readings], error_map.uncertainty[rows]
    with_effects = replace(error_map, points=points, error=error, uncertainty=u, covariance=None)
    return ErrorStates(with_effects, approach[readings], names)


def displacement(effect: Effect, fit: Fit) -> Array:
    """(n, 3) by which a fitted effect moves the tool against the workpiece in each reading, m.

    Zero where the effect is not in the model, and for coefficients that are not determined.
    """
    observations = fit.model.observations
    out = np.zeros((len(observations), 3))
    if (term := next((term for term in fit.model.terms if term.name == effect.id), None)) is None:
        return out
    known = {
        parameter.name: float(parameter.reference + value)
        for parameter, value, good in zip(fit.model.parameters, fit.theta, fit.determined, strict=True)
        if good and parameter.kind is Kind.EFFECT and parameter.owner == effect.id
    }
    shape = shape_of(effect, term, observations, known)
    size = np.array([known.get(f"{effect.id}.{c.name}", 0.0) for c in effect.coefficients_for(observations, shape)])
    for j in range(3):
        along, across = np.tile(np.eye(3)[j], (len(observations), 1)), np.zeros((len(observations), 3))
        turned = None if observations.rotation_direction is None else across
        for sign, tool, table in ((1.0, along, across), (-1.0, across, along)):
            look = replace(observations, direction=tool, table_direction=table, rotation_direction=turned)
            out[:, j] += sign * (size @ effect.columns(look, shape))
    return out


def _directions(observations: Observations) -> Array:
    columns = observations.readings.columns
    signs = [np.asarray(columns.get(f"dir_{axis}", np.zeros(len(observations))), dtype=float) for axis in "xyz"]
    return np.asarray(np.nan_to_num(np.stack(signs, axis=1)))


def _mapped(fit: Fit, effects: Sequence[str]) -> IntArray:
    """The readings of which the map of direct deviations has a row: the first in each state at each place."""
    position = fit.model.observations.position
    fields = [t.field for t in fit.model.terms if t.name in effects and t.field is not None]
    return first_states(position, np.concatenate([np.zeros((0, len(position), 3)), *fields]))[0]


def _nearest(points: Array, places: Array, approach: Array) -> tuple[IntArray, IntArray]:
    """Pairs of a point and a reading that is as near to it as any with the same directions of approach."""
    signs, group = np.unique(approach, axis=0, return_inverse=True)
    known = (signs != 0.0) | (approach == 0.0).all(axis=0)
    used = np.flatnonzero(known.all(axis=1)) if known.all(axis=1).any() else np.arange(len(signs))
    rows, readings = [], []
    for k in used:
        mine = np.flatnonzero(group.ravel() == k)
        tree = cKDTree(places[mine])
        distance, _ = tree.query(points)
        near = tree.query_ball_point(points, distance * (1.0 + 1e-9) + _PLACE)
        found: list[list[int]] = np.asarray(near, dtype=object).tolist()
        rows.append(np.repeat(np.arange(len(points)), [len(own) for own in found]))
        readings += [mine[own] for own in found]
    return np.concatenate(rows), np.concatenate(readings)
