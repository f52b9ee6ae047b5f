# SPDX-License-Identifier: Apache-2.0
"""The error map of a tracking interferometer's session: every target's position error, and the stations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.estimation.points import points_in_inner_datum
from machine_tool_calibration.methods.tracking.datum import MAP_DATUM, turned_back
from machine_tool_calibration.methods.tracking.model import TrackingModel
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import NotDetermined
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.model.rigid_body import MachineTable, in_space, map_field, position_errors
from machine_tool_calibration.words import say

__all__ = ["error_map"]


# Standard uncertainty above which a position error counts as not determined, m.
_VAGUE = 1e-4
# Stations lie in a plane or on a line where their least extent is below this share of the largest.
_FLAT = 0.05


@dataclass(frozen=True)
class _Network:
    """Targets and stations in the map's datum.

    Attributes:
        error: (n, d) position error of the targets.
        covariance: (n, d, d).
        good: (n,) whether a target is determined.
        own: (S (d + 1),) the stations' unknowns.
        own_u: their standard uncertainties.
        why: reason for each target that is not determined.
    """

    error: Array
    covariance: Array
    good: BoolArray
    own: Array
    own_u: Array
    why: Mapping[int, str]


def error_map(model: TrackingModel, fit: Fit) -> ErrorMap:
    """Position error of every target in the datum in which they have no common motion."""
    return _free_map(model, fit) if model.tables is None else _table_map(model, fit, model.tables)


def _free_map(model: TrackingModel, fit: Fit) -> ErrorMap:
    """Every target's position error, from its own unknowns."""
    d, own = model.dimension, fit.places[: len(model.own)]
    stated = fit.joint.marginal
    local, theta = stated.solution.local[fit.index], stated.solution.theta
    nominal, stations = model.targets[:, :d].T, model.stations[:, :d]
    where, at = nominal, stations
    if model.follows:
        # The motions that change no reading are those of the places found.
        where, at = nominal + local, stations + theta[own].reshape(-1, d + 1)[:, :d]
    theta_motion = np.zeros((len(theta), model.motion.count))
    theta_motion[own] = model.motion.of_stations(at)
    result = points_in_inner_datum(
        stated.parts[fit.index], stated.solution, fit.index, model.motion.of_targets(where), theta_motion
    )
    good, error, unknown = result.determined, result.value.T, result.theta[own]
    if model.follows and good.any():
        places = np.vstack([where.T[~good], at])
        error = np.full_like(error, np.nan)
        turned, others = turned_back(nominal.T[good], where.T[good], places)
        error[good] = turned - nominal.T[good]
        unknown = theta[own].reshape(-1, d + 1).copy()
        unknown[:, :d] = others[-len(at) :] - stations
    why = {int(k): _why_lost(model, fit, int(k)) for k in np.flatnonzero(~good)}
    own_u = stated.scatter * np.sqrt(np.diag(result.theta_covariance)[own])
    covariance = stated.scatter**2 * result.covariance.transpose(2, 0, 1)
    return _published(model, fit, _Network(error, covariance, good, unknown.reshape(-1), own_u, why))


def _why_lost(model: TrackingModel, fit: Fit, target: int) -> str:
    """What keeps a target from being determined."""
    if fit.solution.local_determined[fit.index][:, target].all():
        count = len(np.unique(model.observations.readings.setup))
        if count <= model.dimension:
            return say("undetermined.more_stations", needed=model.dimension + 1, count=count)
        return say("undetermined.station_missing")
    stations = np.unique(model.observations.readings.setup[model.point == target])
    if len(stations) >= model.dimension:
        return say("undetermined.narrow")
    if not len(stations):
        return say("undetermined.not_read", needed=model.dimension)
    names = ", ".join(model.description.setups[s].id for s in stations)
    return say("undetermined.read_from", names=names, needed=model.dimension)


def _table_map(model: TrackingModel, fit: Fit, tables: tuple[MachineTable, ...]) -> ErrorMap:
    """Every target's position error from the machine's error motions."""
    d, n = model.dimension, len(model.targets)
    field = map_field(tables, model.targets)[:, :, :d]
    first = len(model.own)
    place = slice(first, first + len(field))
    raw = field.reshape(len(field), -1)
    common = model.motion.at(model.targets[:, :d].T).transpose(2, 0, 1)
    loose = fit.solution.loose_directions()[fit.places][place]

    def told(field: Array) -> BoolArray:
        """(n,) the targets of which every coordinate is determined."""
        return np.asarray((np.linalg.norm(field.T @ loose, axis=1).reshape(n, d) < 1e-9).all(axis=1))

    def without_common(targets: BoolArray) -> tuple[Array, Array]:
        """The common motion of some targets, and the field of all without it."""
        rows = np.repeat(targets, d)
        fitted = np.linalg.lstsq(common[targets].reshape(-1, common.shape[2]), raw[:, rows].T, rcond=None)[0]
        return np.asarray(fitted), raw - (common.reshape(n * d, -1) @ fitted).T

    fitted, flat = without_common(np.ones(n, dtype=bool))
    if (sure := told(raw)).sum() > told(flat).sum():
        # What is not determined at some targets must not shift and turn all others.
        fitted, flat = without_common(sure)
    good = told(flat)
    error, covariance = position_errors(flat.reshape(len(field), n, d), fit.theta[place], fit.covariance[place, place])
    # The stations move with the common motion that is taken out of the targets.
    change = np.eye(len(fit.theta))[:first]
    change[:, place] -= model.motion.of_stations(model.stations[:, :d]) @ fitted
    own_u = np.sqrt(np.einsum("ij,jk,ik->i", change, fit.covariance, change))
    why = {int(k): say("undetermined.motion_missing") for k in np.flatnonzero(~good)}
    return _published(model, fit, _Network(error, covariance, good, change @ fit.theta, own_u, why))


def _published(model: TrackingModel, fit: Fit, network: _Network) -> ErrorMap:
    """The contract's arrays; NaN where not determined."""
    d, good = model.dimension, network.good
    error = np.where(good[:, None], network.error, np.nan)
    covariance = np.where(good[:, None, None], network.covariance, np.nan)
    uncertainty = np.sqrt(np.einsum("nii->ni", covariance))
    fixed = fit.determined[: len(network.own)].reshape(-1, d + 1)
    own = np.where(fixed, network.own.reshape(-1, d + 1), np.nan)
    own_u = np.where(fixed, network.own_u.reshape(-1, d + 1), np.nan)
    # A direction known no better than this says nothing of a machine, and a linear fit little of it.
    vague = uncertainty > _VAGUE
    error, uncertainty = np.where(vague, np.nan, error), np.where(vague, np.nan, uncertainty)
    covariance = np.where(vague[:, :, None] | vague[:, None, :], np.nan, covariance)
    content = {
        "points": model.targets,
        "position_error": error,
        "position_error_u": uncertainty,
        "station_ids": [setup.id for setup in model.description.setups],
        "stations": in_space(model.stations[:, :d] + own[:, :d]),
        "stations_u": in_space(own_u[:, :d]),
        "dead_path": model.path + own[:, d],
        "dead_path_u": own_u[:, d],
        "datum": MAP_DATUM,
    }
    lost = tuple(NotDetermined(f"target {_place(model.targets[k])}", why) for k, why in network.why.items())
    lost += tuple(_vague(model, vague, j) for j in range(d) if vague[:, j].any())
    names = [parameter.name for parameter in model.own]
    moved = dict(zip(names, zip(network.own.tolist(), network.own_u.tolist(), strict=True), strict=True))
    return ErrorMap(content, model.targets, in_space(error), in_space(uncertainty), in_space(covariance), lost, moved)


def _vague(model: TrackingModel, vague: BoolArray, j: int) -> NotDetermined:
    """A direction that the arrangement of the stations hardly senses."""
    count = int(vague[:, j].sum())
    where = "all targets" if count == len(vague) else f"{count} of {len(vague)} targets"
    centred = model.stations[:, : model.dimension] - model.stations[:, : model.dimension].mean(axis=0)
    extents = np.linalg.svd(centred, compute_uv=False)
    # A third or second direction in which the stations hardly differ.
    flat = len(extents) < model.dimension or extents[-1] < _FLAT * extents[0]
    kind = "_line" if model.dimension == 2 or extents[1] < _FLAT * extents[0] else "_plane"
    why = say(f"undetermined.vague{kind if flat else ''}", size=f"{1e3 * _VAGUE:g}")
    return NotDetermined(f"position_error along {'xyz'[j]} of {where}", why)


def _place(position: Array) -> str:
    return "(" + ", ".join(f"{1e3 * v:.6g}" for v in position) + ") mm"
