"""Tracking interferometer: multilateration from several stations (Ibaraki et al. 2014).

`free`: the position of every target is unknown. `rigid_body`: the targets' errors are those of the machine's
error motions and squareness; what these cannot explain stays in the residuals.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation.layout import group_points, group_rows
from machine_tool_calibration.estimation.multilateration import MultilaterationPart
from machine_tool_calibration.estimation.points import points_in_inner_datum
from machine_tool_calibration.estimation.problem import FunctionPart, Part
from machine_tool_calibration.instruments.tracking import beam_direction, distance
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.machine.tables import MachineTable, axis_nodes, linear_axis_errors
from machine_tool_calibration.methods.rigid_body import RIGID_BODY_DATUM, machine_terms, map_field, table_datum
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import Constraint, MethodModel, NotDetermined
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.model.terms import Parameter
from machine_tool_calibration.session.description import TrackingInterferometer
from machine_tool_calibration.session.session import Session

__all__ = ["MODELS", "TrackingModel", "build"]

MODELS = ("free", "rigid_body")

_MAP_DATUM = (
    "no shift and no turn of all targets together against their commanded positions (least squares); the length is "
    "the interferometer's"
)


@dataclass(frozen=True)
class TrackingModel(MethodModel):
    """Targets read from stations.

    Attributes:
        targets: (N, 3) distinct commanded positions, m.
        point: (n,) which of them each reading belongs to.
        stations: (S, 3) first estimates of the rotation centres, m.
        path: (S,) first estimates of the path at the datum reading (dead path), m.
        tables: the machine's error motions in the model; None where every target is free.
    """

    targets: Array
    point: IntArray
    stations: Array
    path: Array
    tables: tuple[MachineTable, ...] | None

    @property
    def _description(self) -> TrackingInterferometer:
        description = self.observations.session.description
        assert isinstance(description, TrackingInterferometer)
        return description

    @property
    def dimension(self) -> int:
        """2 or 3."""
        return self._description.dimension

    @property
    def own(self) -> tuple[Parameter, ...]:
        """Rotation centre and dead path of every station."""
        out = []
        for setup, position, path in zip(self._description.setups, self.stations, self.path, strict=True):
            out += [Parameter(f"{setup.id}.{axis}", "m", reference=float(position[j])) for j, axis in enumerate("xyz"[: self.dimension])]
            out.append(Parameter(f"{setup.id}.dead_path", "m", reference=float(path)))
        return tuple(out)

    def part(self, own_index: IntArray, dense_index: IntArray) -> Part:
        """Free targets are eliminated point by point; tables enter as columns."""
        d = self.dimension
        readings = self.observations.readings
        block_index = own_index.reshape(-1, d + 1)
        path = readings.displacement + self.path[readings.setup]
        beam = self.observations.direction.T[:d] if self._description.pointing == "open_loop" else None
        if self.tables is None:
            return MultilaterationPart(
                group_points(self.point, readings.setup),
                path,
                self.sigma,
                self.targets.T[:d].copy(),
                self.stations.T[:d].copy(),
                beam,
                self.dense(),
                block_index,
                dense_index,
            )
        return FunctionPart(
            group_rows(readings.setup), self.sigma, self._linearise(path, beam), block_index, dense_index, beam is not None
        )

    def _linearise(self, path: Array, beam: Array | None) -> Callable[[Array, Array], tuple[Array, Array, Array]]:
        d = self.dimension
        setup = self.observations.readings.setup
        dense = self.dense()
        along = self.observations.direction.T[:d]
        nominal = self.targets[self.point][:, :d].T - self.stations[setup][:, :d].T

        def linearise(own: Array, shared: Array) -> tuple[Array, Array, Array]:
            line = nominal - own[:, :d][setup].T
            if beam is None:
                # The tables' share of the length is linear; the beam follows the target where it was commanded.
                length = np.linalg.norm(line, axis=0)
                direction = line / length
            else:
                length, direction = np.einsum("dn,dn->n", line, along), along
            residual = path - length + own[:, d][setup] - shared @ dense
            return residual, np.concatenate([-direction, -np.ones((1, len(path)))]), dense

        return linearise

    def _motion(self) -> tuple[Array, Array]:
        """Common motions: (d, t, N) of the targets and (stations (d + 1), t) of the stations' unknowns."""
        d = self.dimension
        centre = self.targets[:, :d].mean(axis=0)
        stations = self.stations[:, :d]
        turns = [(0, 1)] if d == 2 else [(1, 2), (2, 0), (0, 1)]
        size = np.abs(self.targets[:, :d] - centre).max() or 1.0
        targets = np.zeros((d, d + len(turns), len(self.targets)))
        blocks = np.zeros((len(stations), d + 1, d + len(turns)))
        for j in range(d):
            targets[j, j] = 1.0
            blocks[:, j, j] = 1.0
        for k, (a, b) in enumerate(turns, start=d):
            targets[a, k], targets[b, k] = -(self.targets[:, b] - centre[b]) / size, (self.targets[:, a] - centre[a]) / size
            blocks[:, a, k], blocks[:, b, k] = -(stations[:, b] - centre[b]) / size, (stations[:, a] - centre[a]) / size
        return targets, blocks.reshape(-1, d + len(turns))

    def error_map(self, fit: Fit) -> ErrorMap:
        """Position error of every target in the datum in which they have no common motion."""
        d = self.dimension
        n = len(self.targets)
        motion, station_motion = self._motion()
        if self.tables is None:
            theta_motion = np.zeros((len(fit.solution.theta), motion.shape[1]))
            theta_motion[fit.places[: len(station_motion)]] = station_motion
            result = points_in_inner_datum(fit.part, fit.solution, fit.index, motion, theta_motion)
            good = fit.solution.local_determined[fit.index].all(axis=0)
            error, covariance = result.value.T, result.covariance.transpose(2, 0, 1)
            own = fit.places[: len(station_motion)]
            stations, station_u = result.theta[own], np.sqrt(np.diag(result.theta_covariance)[own])
        else:
            field = map_field(self.tables, self.targets)[:, :, :d]
            first = len(self.own)
            tables = slice(first, first + len(field))
            flat = field.reshape(len(field), -1)
            common = motion.transpose(2, 0, 1).reshape(n * d, -1)
            fitted = np.linalg.lstsq(common, flat.T, rcond=None)[0]
            flat = flat - (common @ fitted).T
            error = (fit.theta[tables] @ flat).reshape(n, d)
            inner = fit.covariance[tables, tables]
            blocks = flat.reshape(len(field), n, d)
            covariance = np.einsum("knd,kl,lne->nde", blocks, inner, blocks, optimize=True)
            # The stations move with the common motion that is taken out of the targets.
            change = np.eye(len(fit.theta))[:first]
            change[:, tables] -= station_motion @ fitted
            stations = change @ fit.theta
            station_u = np.sqrt(np.einsum("ij,jk,ik->i", change, fit.covariance, change))
            loose = np.linalg.norm(flat.T @ fit.undetermined[tables], axis=1) if fit.undetermined.size else np.zeros(n * d)
            good = (loose.reshape(n, d) < 1e-9).all(axis=1)
        error = np.where(good[:, None], error, np.nan)
        covariance = np.where(good[:, None, None], covariance, np.nan)
        uncertainty = np.sqrt(np.einsum("nii->ni", covariance))
        stations, station_u = stations.reshape(-1, d + 1), station_u.reshape(-1, d + 1)
        fixed = fit.determined[: stations.size].reshape(-1, d + 1)
        stations, station_u = np.where(fixed, stations, np.nan), np.where(fixed, station_u, np.nan)
        place = np.full((len(stations), 3), np.nan)
        place_u = place.copy()
        place[:, :d] = self.stations[:, :d] + stations[:, :d]
        place_u[:, :d] = station_u[:, :d]
        content = {
            "points": self.targets,
            "position_error": error,
            "position_error_u": uncertainty,
            "station_ids": [setup.id for setup in self._description.setups],
            "stations": place,
            "stations_u": place_u,
            "dead_path": self.path + stations[:, d],
            "dead_path_u": station_u[:, d],
            "datum": _MAP_DATUM,
        }
        lost = tuple(
            NotDetermined(f"target {_place(self.targets[k])}", "it was read from too few stations") for k in np.flatnonzero(~good)
        )
        return ErrorMap(content, self.targets, _three(error), _three(uncertainty), _three_by_three(covariance), lost)


def _place(position: Array) -> str:
    return "(" + ", ".join(f"{1e3 * v:.6g}" for v in position) + ") mm"


def _three(values: Array) -> Array:
    out = np.full((len(values), 3), np.nan)
    out[:, : values.shape[1]] = values
    return out


def _three_by_three(values: Array) -> Array:
    out = np.full((len(values), 3, 3), np.nan)
    d = values.shape[1]
    out[:, :d, :d] = values
    return out


def build(session: Session, model: str = "free") -> TrackingModel:
    """The model of a tracking interferometer's session.

    Args:
        session: the measurement.
        model: `free` or `rigid_body`.
    """
    description = session.description
    assert isinstance(description, TrackingInterferometer)
    d = description.dimension
    readings = session.readings.select(np.isfinite(session.readings.displacement))
    position = readings.position()
    targets, point = _distinct(position[:, :d])
    targets = np.column_stack([targets, np.full((len(targets), 3 - d), position[0, 2] if d == 2 else 0.0)])
    stations = np.array([setup.position for setup in description.setups])
    if d == 2:
        stations = np.column_stack([stations[:, :2], np.full(len(stations), position[0, 2])])
    length = distance(position, stations[readings.setup])
    path = np.zeros(len(stations))
    for s in range(len(stations)):
        mine = np.flatnonzero(readings.setup == s)
        if len(mine):
            path[s] = length[mine[0]] - readings.displacement[mine[0]]
    if description.pointing == "open_loop":
        elevation = readings.columns.get("elevation", np.zeros(len(readings))) if d == 3 else np.zeros(len(readings))
        direction = beam_direction(readings.column("azimuth"), elevation)
    else:
        direction = (position - stations[readings.setup]) / length[:, None]
    observations = Observations(session, readings, position, direction, np.zeros_like(direction), length, readings.setup)
    common = {"observations": observations, "targets": targets, "point": point, "stations": stations, "path": path, "priors": ()}
    if model == "free":
        free = TrackingModel(**common, terms=(), constraints=(), left_out=(), datum=_MAP_DATUM, tables=None)
        _, motion = free._motion()
        names = [parameter.name for parameter in free.own]
        datum = tuple(Constraint({n: float(v) for n, v in zip(names, column, strict=True) if v}) for column in motion.T)
        return TrackingModel(**common, terms=(), constraints=datum, left_out=(), datum=_MAP_DATUM, tables=None)
    chain = Chain.parse(description.machine.chain)
    nodes = {axis: axis_nodes(position[:, j]) for j, axis in enumerate("XYZ"[:d])}
    tables, terms, left_out = machine_terms(observations, linear_axis_errors(chain, nodes))
    return TrackingModel(
        **common, terms=terms, constraints=table_datum(tables), left_out=left_out,
        datum=f"{RIGID_BODY_DATUM}; map: {_MAP_DATUM}", tables=tables,
    )  # fmt: skip


def _distinct(position: Array) -> tuple[Array, IntArray]:
    """Distinct commanded positions, equal to the nanometre, in the order of their first reading; and which is which."""
    keys = np.round(position * 1e9).astype(np.int64)
    code = np.zeros(len(keys), dtype=np.int64)
    for j in range(keys.shape[1]):
        # Ranks keep the code small however large the travel is.
        _, rank = np.unique(keys[:, j], return_inverse=True)
        code = code * (int(rank.max()) + 1) + rank
    _, first, inverse = np.unique(code, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    return position[first[order]], place[inverse.reshape(-1)]
