# SPDX-License-Identifier: Apache-2.0
"""Tracking interferometer: multilateration from several stations (Ibaraki et al. 2014).

`free`: the position of every target is unknown. `rigid_body`: the targets' errors are those of the machine's
error motions and squareness; what these cannot explain stays in the residuals. The map has every target's position
error in the datum in which they have no common motion, and the stations.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, best_motion, group_ranges, unit_vectors
from machine_tool_calibration.estimation.points import points_in_inner_datum
from machine_tool_calibration.estimation.problem import FunctionPart, Part, group_points, group_rows
from machine_tool_calibration.methods.build import vaguest, without_vague
from machine_tool_calibration.methods.tracking import datum
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import (
    Constraint,
    MethodModel,
    NotDetermined,
    Parameter,
    Prior,
    dead_path_of,
    place_of,
)
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.model.rigid_body import (
    RIGID_BODY_DATUM,
    MachineTable,
    axis_nodes,
    in_space,
    linear_axis_errors,
    machine_terms,
    map_field,
    position_errors,
    read_nodes,
    table_datum,
)
from machine_tool_calibration.session.description import TrackingInterferometer
from machine_tool_calibration.session.session import Session, distinct_places
from machine_tool_calibration.words import say

# Stations are set up to this by any means, m. Declared uncertainties below it are not relied on: the readings place a
# station far better, except for motions that they do not sense.
_ROUGHLY = 3e-4
# Share of a coordinate in a motion that is not sensed above which the coordinate is not measured.
_INVOLVED = 0.03


@dataclass(frozen=True)
class TrackingModel(MethodModel):
    """Targets read from stations."""

    targets: Array  # (N, 3) distinct commanded positions, m
    point: IntArray  # (n,) which of them each reading belongs to
    stations: Array  # (S, 3) first estimates of the rotation centres, m
    path: Array  # (S,) first estimates of the path at the datum reading (dead path), m
    sight: datum.OwnSight  # how well each station's own readings place it
    carried: BoolArray  # (S,) stations that the network holds
    tables: tuple[MachineTable, ...] | None  # the machine's error motions in the model; None where every target is free

    @property
    def description(self) -> TrackingInterferometer:
        """What `session.yaml` says."""
        return self.observations.session.description.as_a(TrackingInterferometer)

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self.description.dimension

    @property
    def follows(self) -> bool:
        """Whether the beam follows the target, rather than staying on the commanded direction."""
        return self.description.pointing == "tracking"

    @cached_property
    def motion(self) -> datum.NetworkMotion:
        """Shifts and turns of the whole network."""
        return datum.NetworkMotion(self.targets[:, : self.dimension])

    @property
    def own(self) -> tuple[Parameter, ...]:
        """Rotation centre and dead path of every station."""
        out = []
        for setup, position, path in zip(self.description.setups, self.stations, self.path, strict=True):
            out += [place_of(setup.id, "xyz"[j], float(position[j])) for j in range(self.dimension)]
            out.append(dead_path_of(setup.id, float(path)))
        return tuple(out)

    @property
    def own_names(self) -> np.ndarray:
        """(S, d + 1) their names."""
        return np.array([parameter.name for parameter in self.own]).reshape(len(self.stations), -1)

    @cached_property
    def unsensed_stations(self) -> list[tuple[int, Array]]:
        """Motions that the own readings of a station hardly sense; stations that nothing holds are left out."""
        unsensed = self.sight.unsensed(self.observations.session.sigma, self.known)
        return [(k, vector) for k, vector in unsensed if self.carried[k]]

    @cached_property
    def declared(self) -> frozenset[str]:
        """Coordinates of stations for which the declared position stands."""
        names = self.own_names
        return frozenset(str(n) for k, v in self.unsensed_stations for n in names[k][np.abs(v) > _INVOLVED])

    def why_not_determined(self, name: str) -> str | None:
        """A station's coordinate that hardly changes its readings."""
        return say("undetermined.station_loose") if name in self.declared else None

    @property
    def known(self) -> Array:
        """(S,) what is taken as known of the stations' positions beforehand, at least, m."""
        # By one who says nothing of it no better than readings say where they are.
        unsaid = self.observations.session.sigma
        return np.maximum([setup.position_uncertainty or unsaid for setup in self.description.setups], _ROUGHLY)

    def part(self, own_index: IntArray, dense_index: IntArray) -> Part:
        """Free targets are eliminated point by point; tables enter as columns."""
        d = self.dimension
        readings = self.observations.readings
        block_index = own_index.reshape(-1, d + 1)
        path = readings.displacement + self.path[readings.setup]
        beam = None if self.follows else self.observations.direction.T[:d]
        if self.tables is None:
            groups, places = group_points(self.point, readings.setup), (self.targets, self.stations)
            target, station = (place.T[:d].copy() for place in places)
            return datum.MultilaterationPart(
                groups, path, self.sigma, target, station, beam, self.dense(), block_index, dense_index
            )
        nominal = (self.targets[self.point] - self.stations[readings.setup])[:, :d].T
        linearise = partial(_linearised, path, nominal, self.dense(), readings.setup, beam)
        groups = group_rows(readings.setup)
        return FunctionPart(groups, self.sigma, linearise, block_index, dense_index, not self.follows)


def _linearised(
    path: Array, nominal: Array, dense: Array, setup: IntArray, beam: Array | None, own: Array, shared: Array
) -> tuple[Array, Array, Array]:
    """Residuals and their columns at a place of the unknowns: a function that goes from process to process."""
    d = len(nominal)
    line = nominal - own[:, :d][setup].T
    if beam is None:
        # The tables' share of the length is linear; the beam follows the target where it was commanded.
        length = np.linalg.norm(line, axis=0)
        direction = line / length
    else:
        length, direction = np.einsum("dn,dn->n", line, beam), beam
    residual = path - length + own[:, d][setup] - shared @ dense
    return residual, np.concatenate([-direction, -np.ones((1, len(path)))]), dense


def build(session: Session, model: str = "free") -> TrackingModel:
    """The model of a tracking interferometer's session, with free targets or the machine's tables."""
    free = _free(session)
    if model == "free":
        return replace(free, constraints=_station_datum(free))
    nodes = {axis: axis_nodes(free.targets[:, j]) for j, axis in enumerate("XYZ"[: free.dimension])}
    candidates = linear_axis_errors(free.description.machine.kinematics, nodes)
    tables, terms, left_out = machine_terms(free.observations, candidates)
    constraints = table_datum(tables, [read_nodes(term.columns) for term in terms])
    both = say("datum.and_map", own=RIGID_BODY_DATUM, map=datum.MAP_DATUM)
    return replace(free, terms=terms, constraints=constraints, left_out=left_out, datum=both, tables=tables)


def _free(session: Session) -> TrackingModel:
    """The model with free targets, without a datum."""
    description = session.description.as_a(TrackingInterferometer)
    d = description.dimension
    # A target whose readings were all lost is a target all the same: it keeps its place in the map.
    read = np.isfinite(session.readings.displacement)
    everywhere = session.readings.position()[:, :d]
    first, point = distinct_places(everywhere)
    targets, readings = everywhere[first], session.readings
    if not read.all():
        readings, point = readings.select(read), point[read]
    position = readings.position()
    stations = np.array([setup.position for setup in description.setups])
    if d == 2:
        # The plane of the targets is that of the measurement.
        level = position[0, 2] if len(position) else 0.0
        targets = np.column_stack([targets, np.full(len(targets), level)])
        stations[:, 2] = level
    line = position - stations[readings.setup]
    line[:, d:] = 0.0
    length = np.sqrt(np.einsum("nj,nj->n", line, line))
    direction = line / np.maximum(length, 1e-9)[:, None]
    if description.pointing == "open_loop":
        elevation = readings.columns.get("elevation", np.zeros(len(readings))) if d == 3 else np.zeros(len(readings))
        direction = unit_vectors(readings.column("azimuth"), elevation)
    readings = readings.at_places(line / np.maximum(length, 1e-9)[:, None])
    # No single reading decides; a station that read nothing has a path of zero.
    path = np.nan_to_num(group_ranges(length - readings.displacement, readings.setup, len(stations))[1])
    observed = Observations(session, readings, position, direction, np.zeros_like(direction), length, readings.setup)
    free = TrackingModel(
        observations=observed,
        terms=(),
        constraints=(),
        priors=(),
        left_out=(),
        datum=datum.MAP_DATUM,
        targets=targets,
        point=point,
        stations=stations,
        path=path,
        sight=datum.OwnSight(direction[:, :d], readings.setup, len(stations)),
        carried=datum.carried_stations(point, readings.setup, len(targets), len(stations), d),
        tables=None,
    )
    return replace(free, priors=tuple(_known_places(free)))


def _station_datum(model: TrackingModel) -> tuple[Constraint, ...]:
    """No shift and no turn of the stations that the network carries; the map is carried over to the targets' datum."""
    d, count = model.dimension, len(model.stations)
    placed = model.sight.projectors(model.observations.session.sigma, model.known) * model.carried[:, None, None]
    motion = model.motion.of_stations(model.stations[:, :d]).reshape(count, d + 1, -1)
    rows = (placed @ motion).reshape(count * (d + 1), -1).T
    names = [parameter.name for parameter in model.own]
    return tuple(Constraint({n: float(v) for n, v in zip(names, row, strict=True) if v}) for row in rows)


def _known_places(model: TrackingModel) -> Iterator[Prior]:
    """What is declared of stations, for those motions of theirs that their own readings hardly sense."""
    names = model.own_names
    for k, vector in model.unsensed_stations:
        weights = {str(n): float(v) for n, v in zip(names[k], vector, strict=True) if v}
        yield Prior(weights, 0.0, float(model.known[k]))


# Stations lie in a plane or on a line where their least extent is below this share of the largest.
_FLAT = 0.05


def error_map(model: TrackingModel, fit: Fit) -> ErrorMap:
    """Position error of every target in the datum in which they have no common motion."""
    return _free_map(model, fit) if model.tables is None else _table_map(model, fit, model.tables)


def _free_map(model: TrackingModel, fit: Fit) -> ErrorMap:
    d, own = model.dimension, fit.places[: len(model.own)]
    marginal = fit.joint.marginal
    local, theta = marginal.solution.local[fit.index], marginal.solution.theta
    nominal, stations = model.targets[:, :d].T, model.stations[:, :d]
    where, at = nominal, stations
    if model.follows:
        # The motions that change no reading are those of the places found.
        where, at = nominal + local, stations + theta[own].reshape(-1, d + 1)[:, :d]
    theta_motion = np.zeros((len(theta), model.motion.count))
    theta_motion[own] = model.motion.of_stations(at)
    # Of some of the targets at a time, so that memory holds only these.
    part, motion = marginal.parts[fit.index], lambda points: model.motion.at(where[:, points])
    result = points_in_inner_datum(part, marginal.solution, fit.index, motion, theta_motion)
    good, error, unknown = result.determined, result.value.T, result.theta[own]
    if model.follows and good.any():
        # The turn is finite: with stations known to a millimetre the network may have turned by a milliradian, and the
        # linear datum would leave its square, half a micrometre on a metre.
        turn, shift = best_motion(where.T[good], nominal.T[good])
        error = np.where(good[:, None], where.T @ turn.T + shift - nominal.T, np.nan)
        unknown = theta[own].reshape(-1, d + 1).copy()
        unknown[:, :d] = at @ turn.T + shift - stations
    why = {int(k): _why_lost(model, fit, int(k)) for k in np.flatnonzero(~good)}
    own_u = marginal.scatter * np.sqrt(np.diag(result.theta_covariance)[own])
    covariance = marginal.scatter**2 * result.covariance.transpose(2, 0, 1)
    return _published(model, fit, error, covariance, good, unknown.reshape(-1), own_u, why)


def _why_lost(model: TrackingModel, fit: Fit, target: int) -> str:
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
    d, n = model.dimension, len(model.targets)
    field = map_field(tables, model.targets)[:, :, :d]
    first = len(model.own)
    place = slice(first, first + len(field))
    raw = field.reshape(len(field), -1)
    common = model.motion.at(model.targets[:, :d].T).transpose(2, 0, 1)
    unsensed = fit.solution.undetermined_directions()[fit.places][place]

    def told(field: Array) -> BoolArray:
        """(n,) the targets of which every coordinate is determined."""
        return np.asarray((np.linalg.norm(field.T @ unsensed, axis=1).reshape(n, d) < 1e-9).all(axis=1))

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
    return _published(model, fit, error, covariance, good, change @ fit.theta, own_u, why)


def _published(
    model: TrackingModel, fit: Fit, error: Array, covariance: Array, good: BoolArray, unknown: Array, u: Array,
    why: Mapping[int, str],
) -> ErrorMap:  # fmt: skip
    """By targets that are `good` (n,) or not, and `why` not; and by unknowns of the stations (S (d + 1),) with u."""
    d = model.dimension
    error, covariance = np.where(good[:, None], error, np.nan), np.where(good[:, None, None], covariance, np.nan)
    error, uncertainty, covariance, vague = without_vague(fit, error, covariance)
    fixed = fit.determined[: len(unknown)]
    own, own_u = (np.where(fixed, of_all, np.nan).reshape(-1, d + 1) for of_all in (unknown, u))
    content = {
        "points": model.targets,
        "position_error": error,
        "position_error_u": uncertainty,
        "station_ids": [setup.id for setup in model.description.setups],
        "stations": in_space(model.stations[:, :d] + own[:, :d]),
        "stations_u": in_space(own_u[:, :d]),
        "dead_path": model.path + own[:, d],
        "dead_path_u": own_u[:, d],
        "datum": datum.MAP_DATUM,
    }
    places = {k: ", ".join(f"{1e3 * v:.6g}" for v in model.targets[k]) for k in why}
    lost = tuple(NotDetermined(f"target ({places[k]}) mm", reason) for k, reason in why.items())
    lost += tuple(_vague(model, vague, j, vaguest(fit)) for j in range(d) if vague[:, j].any())
    names = [parameter.name for parameter in model.own]
    moved = dict(zip(names, zip(unknown.tolist(), u.tolist(), strict=True), strict=True))
    return ErrorMap(content, model.targets, in_space(error), in_space(uncertainty), in_space(covariance), lost, moved)


def _vague(model: TrackingModel, vague: BoolArray, j: int, most: float) -> NotDetermined:
    """A direction that the arrangement of the stations hardly senses: by more than so much, m, it is uncertain."""
    count = int(vague[:, j].sum())
    where = "all targets" if count == len(vague) else f"{count} of {len(vague)} targets"
    centred = model.stations[:, : model.dimension] - model.stations[:, : model.dimension].mean(axis=0)
    extents = np.linalg.svd(centred, compute_uv=False)
    # A third or second direction in which the stations hardly differ.
    flat = len(extents) < model.dimension or extents[-1] < _FLAT * extents[0]
    kind = "_line" if model.dimension == 2 or extents[1] < _FLAT * extents[0] else "_plane"
    why = say(f"undetermined.vague{kind if flat else ''}", size=f"{1e3 * most:g}")
    return NotDetermined(f"position_error along {'xyz'[j]} of {where}", why)
