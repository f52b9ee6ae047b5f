# SPDX-License-Identifier: Apache-2.0
"""What a fit of direct deviations says: position errors, tables, and the figures of ISO 230-2 runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, rigid_motions, rms
from machine_tool_calibration.methods.direct.datum import SetupDatum
from machine_tool_calibration.methods.direct.model import DirectModel
from machine_tool_calibration.methods.direct.plate import plate_steps
from machine_tool_calibration.methods.iso230_2 import diagonal_tests, positioning_runs
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
from machine_tool_calibration.words import say

__all__ = ["error_map", "sensed_axes"]


_LOOSE = 1e-9
# Share of the sum of squares from which scatter and reversal are all of it.
_ALL = 0.95
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
    told = observations.readings.columns
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
        "approach": np.array([told.get(f"dir_{axis}", np.zeros(n))[first] for axis in "xyz"]).T,
        "tables": _tables(tables, fit, own),
        "spread_over_declared": float(np.sqrt(fit.joint.reduced_chi_square)),
        "datum": _words(setups, bool(common.shape[1])),
    }
    # These are of the readings themselves: a restated fit changes nothing of them.
    if fit.joint.given is None:
        runs, steps = positioning_runs(observations), plate_steps(observations, setups)
        content["scatter"] = _scatter(observations, fit, runs)
        content |= ({"iso230_2": runs} if runs else {}) | diagonal_tests(observations)
        content |= {} if steps is None else {"plate": steps}
    return ErrorMap(content, points, error, uncertainty, covariance)


def _scatter(observations: Observations, fit: Fit, runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What the readings scatter about the model, what was declared, and on which the standard uncertainties rest.

    Where beside the scatter only the reversal of runs by ISO 230-2 is in it, also what readings of one position and
    direction scatter about their mean, with the p-value of as much with the declared uncertainty.
    """
    sigma, ratio = fit.model.sigma, float(np.sqrt(fit.joint.reduced_chi_square))
    declared = rms(sigma) if np.ptp(sigma) > 0 else observations.session.sigma
    own: dict[str, Any] = {}
    if len(runs) == len(observations.session.setup_ids) and all(np.isfinite(run["B"]) for run in runs):
        squares, freedom, reversal = _by_direction(runs)
        if freedom and squares + reversal > _ALL * float(np.sum(fit.residuals**2)):
            p_value = float(stats.chi2.sf(squares / declared**2, freedom))
            own = {"one_direction": float(np.sqrt(squares / freedom)), "one_direction_p_value": p_value}
    return {
        **own,
        "declared": declared,
        "found": ratio * declared,
        "uncertainties_from": "scatter" if fit.scatter_factor > 1.0 else "declared",
        "factor": fit.scatter_factor,
    }


def _by_direction(runs: Sequence[Mapping[str, Any]]) -> tuple[float, int, float]:
    """Sum of squares about the means of a position and direction, its degrees of freedom, and that of the reversal."""
    squares, freedom, reversal = 0.0, 0, 0.0
    for run in runs:
        up, down = run["count_up"], run["count_down"]
        freedom += int((up - 1).clip(0).sum() + (down - 1).clip(0).sum())
        squares += float(np.nansum((up - 1) * run["s_up"] ** 2) + np.nansum((down - 1) * run["s_down"] ** 2))
        reversal += float(np.sum(up * down / (up + down) * run["reversal"] ** 2))
    return squares, freedom, reversal


def _words(setups: SetupDatum, reduced: bool) -> str:
    what = {"none": "tables", "offset": "offsets", "rigid": "shifts"}[setups.kind]
    return say(f"datum.nothing_of_{what}") if reduced else setups.words


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
