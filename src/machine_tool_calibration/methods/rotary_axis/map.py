# SPDX-License-Identifier: Apache-2.0
"""What a fit of a rotary axis says: error motions, errors of the targets, and where the axis average line stands."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from machine_tool_calibration.arrays import Array, rigid_motions
from machine_tool_calibration.methods.rotary_axis.datum import ROTARY_DATUM
from machine_tool_calibration.methods.rotary_axis.model import RotaryAxisModel
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import NotDetermined
from machine_tool_calibration.model.result import ErrorMap, determined_values
from machine_tool_calibration.session.checks.places import off_stated
from machine_tool_calibration.words import say

_STEPS = 20


def line_names(axis: str) -> tuple[tuple[str, int], ...]:
    """ISO 230-1 names of an axis average line's errors and their places among (X, Y, Z, A, B, C): X0C Y0C A0C B0C."""
    along = "ABC".index(axis)
    shifts = tuple((f"{'XYZ'[j]}0{axis}", j) for j in range(3) if j != along)
    return shifts + tuple((f"{'ABC'[j]}0{axis}", 3 + j) for j in range(3) if j != along)


def average_line(stations: Array, covariance: Array, nominal: Array, uncertainty: Array) -> tuple[Array, Array] | None:
    """(6,) shift and turn (rotation vector) from the frame of the axis to the machine's, m and rad, and covariance.

    nominal = R(turn) station + shift, by weighted least squares, from stations (S, 3) with their covariance (3 S, 3
    S) and nominal ones with the standard uncertainty (S,) of a coordinate; the turn of a table that stands tilted
    is large. None where the stations do not determine it.
    """
    if len(stations) < 3:
        return None
    known = np.repeat(uncertainty**2, 3)
    turn, shift = Rotation.identity(), np.zeros(3)
    inverse = np.zeros((6, 6))
    for _ in range(_STEPS):
        seen = turn.apply(stations)
        flat = rigid_motions(seen).reshape(-1, 6)
        carry = np.kron(np.eye(len(stations)), turn.as_matrix())
        weight = np.linalg.inv(carry @ covariance @ carry.T + np.diag(known))
        normal = flat.T @ weight @ flat
        if np.linalg.cond(normal) > 1e12:
            return None
        inverse = np.asarray(np.linalg.inv(normal), dtype=np.float64)
        step = inverse @ flat.T @ weight @ (nominal - seen - shift).ravel()
        shift, turn = shift + step[:3], Rotation.from_rotvec(step[3:]) * turn
        if np.abs(step).max() < 1e-12:
            break
    return np.concatenate([shift, turn.as_rotvec()]), inverse


# Movement of a target per unit of an unseen motion from which its place is not determined.
_MOVED = 1e-3
# Uncertainties by which a station is off its stated position from which on it says nothing of where the axis stands.
_MISPLACED = 20.0


def error_map(model: RotaryAxisModel, fit: Fit) -> ErrorMap:
    """The contract's content for `rotary_axis`."""
    table, stations, targets = model.table, model.stations, model.targets
    k, own, s = len(table.nodes), len(model.own), stations.size
    theta, sigma = determined_values(fit)
    content: dict[str, Any] = {table.axis.lower(): table.nodes}
    for j, name in enumerate(table.motions):
        mine = slice(own + j * k, own + (j + 1) * k)
        content[name], content[f"{name}_u"] = theta[mine], sigma[mine]
    points, error, cov = _position_errors(model, fit)
    uncertainty = np.sqrt(np.einsum("nii->ni", cov).clip(0.0))
    place = slice(own + 6 * k, own + 6 * k + targets.size)
    line, why = _line(model, fit)
    content |= {
        "points": points,
        "position_error": error,
        "position_error_u": uncertainty,
        "target_ids": [target.id for target in model.description.targets],
        "targets": targets + theta[place].reshape(-1, 3),
        "targets_u": sigma[place].reshape(-1, 3),
        "station_ids": [setup.id for setup in model.description.setups],
        "stations": stations + theta[:s].reshape(-1, 3),
        "stations_u": sigma[:s].reshape(-1, 3),
        "axis_average_line": line,
        "datum": ROTARY_DATUM,
        "iso230_7": _error_motion_values(model, fit),
    }
    untold = tuple(NotDetermined(name, why) for name, _ in line_names(table.axis)) if why else ()
    return ErrorMap(content, points, error, uncertainty, cov, untold)


def _error_motion_values(model: RotaryAxisModel, fit: Fit) -> list[dict[str, Any]]:
    """Error motion values of ISO 230-7:2015, Clause 3: the range of each over the angles that tell it, U (k = 2).

    Relative to the axis average line, sensed in the machine's fixed directions, of all revolutions: the synchronous
    ones.
    """
    table, out = model.table, []
    for j, name in enumerate(table.motions):
        mine = len(model.own) + j * len(table.nodes) + np.arange(len(table.nodes))
        mine = mine[fit.determined[mine]]
        along, value, u = name[1] in (table.axis, "XYZ"["ABC".index(table.axis)]), np.nan, np.nan
        kind = ("tilt", "angular positioning") if name[1] in "ABC" else ("radial", "axial")
        if len(mine) > 1:
            high, low = mine[np.argmax(fit.theta[mine])], mine[np.argmin(fit.theta[mine])]
            value = float(fit.theta[high] - fit.theta[low])
            between = fit.covariance[high, high] + fit.covariance[low, low] - 2.0 * fit.covariance[high, low]
            u = float(np.sqrt(max(between, 0.0)))
        told = {"kind": kind[along], "motion": name, "angles": len(mine), "value": value, "U": 2.0 * u}
        out.append({**told, "unit": "rad" if name[1] in "ABC" else "m"})
    return out


def _position_errors(model: RotaryAxisModel, fit: Fit) -> tuple[Array, Array, Array]:
    """(n, 3) nominal places of every target at every angle, their errors and (n, 3, 3) covariances."""
    k, t, own = len(model.table.nodes), len(model.targets), len(model.own)
    arm = np.einsum("kij,tj->kti", model.table.node_rotation, model.targets).reshape(-1, 3)
    field = rigid_motions(arm)
    index = own + np.arange(6)[None, :] * k + np.repeat(np.arange(k), t)[:, None]
    error = np.einsum("nij,nj->ni", field, fit.theta[index])
    inner = fit.covariance[index[:, :, None], index[:, None, :]]
    covariance = np.einsum("nij,njk,nlk->nil", field, inner, field)
    # What is unseen at an angle does not move the targets on which it turns; others it does.
    unseen = np.repeat(model.loose, t, axis=0) / np.repeat([1.0, model.size], 3)[:, None]
    open_ = np.linalg.norm(np.einsum("nij,njk->nik", field, unseen), axis=(1, 2)) > _MOVED
    if fit.undetermined.size:
        open_ |= np.linalg.norm(np.einsum("nij,njk->nik", field, fit.undetermined[index]), axis=(1, 2)) > 1e-6
    error[open_], covariance[open_] = np.nan, np.nan
    return arm, error, covariance


def _line(model: RotaryAxisModel, fit: Fit) -> tuple[dict[str, Any], str]:
    """The axis average line in the machine frame, None where it is not given, and why if a station stands elsewhere."""
    setups = model.description.setups
    placed = np.asarray(fit.determined[: 3 * len(setups)].reshape(-1, 3).all(axis=1))
    known = [s for s, setup in enumerate(setups) if setup.position_uncertainty is not None and placed[s]]
    result, why = None, ""
    if known:
        index = np.concatenate([3 * s + np.arange(3) for s in known])
        found = model.stations[known] + fit.theta[index].reshape(-1, 3)
        covariance = fit.covariance[np.ix_(index, index)]
        stated = np.array([setups[s].position for s in known])
        uncertainty = np.array([setups[s].position_uncertainty for s in known])
        off = np.linalg.norm(off_stated(found, stated), axis=1)
        u = np.sqrt(uncertainty**2 + np.diag(covariance).reshape(-1, 3).sum(axis=1))
        worst = int(np.argmax(off / u))
        if off[worst] > _MISPLACED * u[worst]:
            name = setups[known[worst]].id
            why = say("undetermined.station_elsewhere", name=repr(name), off=f"{1e3 * off[worst]:.3g}")
        else:
            result = average_line(found, covariance, stated, uncertainty)
    out: dict[str, Any] = {}
    for name, j in line_names(model.table.axis):
        out[name] = None if result is None else float(result[0][j])
        out[f"{name}_u"] = None if result is None else float(np.sqrt(result[1][j, j]))
    return out, why
