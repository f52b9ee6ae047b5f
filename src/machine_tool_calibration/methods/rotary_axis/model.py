# SPDX-License-Identifier: Apache-2.0
"""Rotary axis by sequential multilateration: all six error motions at every angle (Zhang et al. 2015).

One tracker at several stations after another reads the change of distance to targets on the table. A target at p
(table frame, at zero) stands at q = R p + delta + epsilon x R p (Eq. (7); Eq. (3) is misprinted and Eq. (4) has the
opposite sign), R the commanded rotation; the reading is |q - station| minus its value at the datum of the run. Unknown
are the stations, the targets, the path at each run's datum, and delta and epsilon at every angle.

Stations and targets are known roughly; that only gives the first estimates. Their stated uncertainties do not weigh on
the error motions, so a nominal place that is wrong by more than stated does no harm.

A fit says of it error motions, errors of the targets, and where the axis average line stands.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from machine_tool_calibration.arrays import Array, IntArray, group_ranges, rigid_motions
from machine_tool_calibration.coverage import K
from machine_tool_calibration.errors import ModelError, suspected
from machine_tool_calibration.estimation.problem import FunctionPart, Part, group_rows
from machine_tool_calibration.estimation.robust import robust_start
from machine_tool_calibration.methods.rotary_axis import datum
from machine_tool_calibration.methods.rotary_axis.geometry import TableReadings, stated_places, table_readings
from machine_tool_calibration.methods.rotary_axis.start import (
    SURVEYED,
    Start,
    find_start,
    refuse_mistakes,
    refuse_wrong_rows,
)
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import (
    MethodModel,
    NotDetermined,
    Parameter,
    Term,
    assemble,
    dead_path_of,
    motion_value,
    place_of,
)
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.result import ErrorMap, determined_values
from machine_tool_calibration.session.checks.places import off_declared, refuse_misplaced
from machine_tool_calibration.session.description import RotaryAxis, StationSetup, Target
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import figures, say, together

# Misfit of a table turning without error above which it is tried whether one with errors fits, m; and median residual
# of that, over the declared uncertainty, that says that stations and targets were not found.
_DOUBTFUL = 3e-5
_LOST = 30.0
# The same below which single runs can be judged by it, m.
_ROUGH = 2e-4

# Turn above which the readings fix the stations well, rad.
_LARGE_TURN = 1.9


@dataclass(frozen=True)
class RotaryAxisModel(MethodModel):
    """Targets on a rotary table read from stations."""

    table: TableReadings  # the readings sorted by angle, target and run
    stations: Array  # (S, 3) first estimates, in the frame of the axis, m
    targets: Array  # (T, 3) first estimates, table frame at zero, m
    unsensed: Array  # (K, 6, 6) what the readings at each angle do not sense, see `datum.unsensed_motions`
    size: float  # length by which rotations were compared with translations there, m

    @property
    def description(self) -> RotaryAxis:
        """The session's description."""
        return self.observations.session.description.as_a(RotaryAxis)

    @property
    def own(self) -> tuple[Parameter, ...]:
        """Rotation centre of every station, and path at the datum of every run."""
        out = _places(self.description.setups, self.stations)
        repeated = len(np.unique(self.table.run_key[:, 1])) > 1
        for (setup, repeat, target), path in zip(self.table.run_key, self.datum_path, strict=True):
            pair = f"{self.description.setups[setup].id}.{self.description.targets[target].id}"
            out.append(dead_path_of(pair, float(path), int(repeat) if repeated else None))
        return tuple(out)

    @cached_property
    def datum_path(self) -> Array:
        """(runs,) first estimate of the path at which each run reads zero, m: no single reading decides."""
        zero = self.observations.path - self.table.readings.displacement
        return group_ranges(zero, self.table.run, len(self.table.run_key))[1]

    def part(self, own_index: IntArray, dense_index: IntArray) -> Part:
        """Every station is a block: its place, and the zeros of its runs."""
        count = 3 * len(self.stations)
        station = own_index[:count].reshape(-1, 3)
        order = self._order_of_run()
        # A station with fewer runs than others has columns of zeros there, which may point anywhere.
        zeros = np.repeat(station[:, :1], int(order.max()) + 1, axis=1)
        zeros[self.table.run_key[:, 0], order] = own_index[count:]
        blocks, groups = np.column_stack([station, zeros]), group_rows(self.table.readings.setup)
        return FunctionPart(groups, self.sigma, self._linearise(), blocks, dense_index, linear=False)

    def _order_of_run(self) -> IntArray:
        """(runs,) place of each run among those of its station."""
        setup = self.table.run_key[:, 0]
        return np.arange(len(setup)) - np.searchsorted(setup, setup)

    def _linearise(self) -> Callable[[Array, Array], tuple[Array, Array, Array]]:
        table = self.table
        n = len(table.readings)
        path = table.readings.displacement + self.datum_path[table.run]
        setup = table.readings.setup
        stations = self.stations[setup]
        zero = 3 + self._order_of_run()[table.run]
        offsets = np.zeros((int(zero.max()) - 2, n))
        offsets[zero - 3, np.arange(n)] = -1.0
        return partial(self._linearised, self.dense(), path, stations, zero, offsets)

    def _linearised(
        self, dense: Array, path: Array, stations: Array, zero: IntArray, offsets: Array, own: Array, shared: Array
    ) -> tuple[Array, Array, Array]:
        """Residuals and their columns at a place of the unknowns."""
        table, setup = self.table, self.table.readings.setup
        k, t = len(table.nodes), len(self.targets)
        first = 6 * k + 3 * t
        motion = shared[: 6 * k].reshape(6, k)[:, table.node].T
        moved = shared[6 * k : first].reshape(t, 3)
        arm = table.turned(self.targets + moved)
        away = arm + motion[:, :3] + np.cross(motion[:, 3:], arm) - stations - own[setup, :3]
        length = np.linalg.norm(away, axis=1)
        g = away / length[:, None]
        columns = dense.copy()
        _fill(columns, table, g, arm, motion[:, 3:])
        residual = path + own[setup, zero] - length - shared[first:] @ dense[first:]
        return residual, np.concatenate([-g.T, offsets]), columns

    @property
    def declared(self) -> frozenset[str]:
        """Error motions at angles whose readings do not sense them."""
        return datum.unseen_names(self.unsensed, self._labels(), self.observations.session.sigma)

    def _labels(self) -> list[list[str]]:
        return [[parameter.name for parameter in term.parameters] for term in self.terms[:6]]

    def why_not_determined(self, name: str) -> str | None:
        """Which stations and targets took part at the angle of an error motion."""
        table = self.table
        if name not in self.declared:
            return None
        k = next(row.index(name) for row in self._labels() if name in row)
        here = table.node == k
        seen = [self.description.targets[t].id for t in np.unique(table.target[here])]
        stations = [self.description.setups[s].id for s in np.unique(table.readings.setup[here])]
        return _why_unsensed(seen, stations)


def _why_unsensed(seen: list[str], stations: list[str]) -> str:
    if not seen:
        return say("undetermined.no_target")
    if len(seen) == 1:
        return say("undetermined.one_target", a=seen[0])
    if len(seen) == 2:
        return say("undetermined.two_targets", a=seen[0], b=seen[1])
    if len(stations) == 1:
        return say("undetermined.one_station", a=stations[0])
    if len(stations) == 2:
        return say("undetermined.two_stations", a=stations[0], b=stations[1])
    return say("undetermined.not_all_motions", names=", ".join(seen))


def _fill(columns: Array, table: TableReadings, g: Array, arm: Array, tilt: Array) -> None:
    """Columns of tables and targets, in place: g.(epsilon x arm) = epsilon.(arm x g); R dp is turned by epsilon too."""
    k, n = len(table.nodes), len(g)
    rows = np.arange(n)
    turned = np.cross(arm, g)
    on_table = np.einsum("nij,ni->nj", table.rotation, g + np.cross(g, tilt))
    for j in range(3):
        columns[j * k + table.node, rows] = g[:, j]
        columns[(3 + j) * k + table.node, rows] = turned[:, j]
        columns[6 * k + 3 * table.target + j, rows] = on_table[:, j]


def build(session: Session, model: str = "free") -> RotaryAxisModel:
    """The model of a rotary axis's session: every angle has its own six errors.

    A ModelError says that the readings contradict the geometry in a way that a common mistake explains.
    """
    table = table_readings(session)
    start = find_start(table, *stated_places(session), tilted=True)
    if not session.description.trust_units:
        refuse_mistakes(session, start)
    first = _model(session, table, start)
    if start.misfit > _DOUBTFUL:
        _check_places(first)
    if not session.description.trust_units:
        with suspected():
            refuse_misplaced(session, {"stations": start.stations, "targets": start.targets})
        if start.misfit < _ROUGH:
            refuse_wrong_rows(session, start)
    if len(np.unique(table.target)) > 2 and datum.covered_angle(table) > _LARGE_TURN:
        return first
    held = _held(first)
    if len(np.unique(table.target)) < 3:
        # What is undetermined then depends on where stations and targets are: say so at their fitted places.
        held = _held(_model(session, table, _moved(start, held)))
    return held


def _check_places(model: RotaryAxisModel) -> None:
    """Refuse (ModelError) where even a table that moves as it likes at every angle is missed."""
    session = model.observations.session
    residuals = robust_start(assemble([model]).problem).residuals[0]
    missed = float(np.median(np.abs(residuals))) * session.sigma
    if not missed <= _LOST * session.sigma:
        if not session.description.trust_units:
            refuse_wrong_rows(session, Start(*stated_places(session), missed), found=False)
        by = f" by {figures(1e3 * missed)} mm in the middle" if np.isfinite(missed) else ""
        raise ModelError(
            f"{session.source}: no places of stations and targets near the stated ones explain the "
            f"readings (they are missed{by}); {SURVEYED}"
        )


def _held(model: RotaryAxisModel) -> RotaryAxisModel:
    """The model with the stated places of stations and targets, as far as the readings leave them open."""
    entries: list[StationSetup | Target] = [*model.description.setups, *model.description.targets]
    nominal = np.ravel([entry.position for entry in entries])
    declared = max(entry.position_uncertainty or 0.0 for entry in entries)
    names = [p.name for p in model.own[: model.stations.size]] + [p.name for p in model.terms[6].parameters]
    priors = datum.weak_places(model, names, nominal, max(datum.HELD_WITHIN, 10 * declared))
    if not priors:
        return model
    words = together((model.datum, say("datum.held", n=len(priors))), "; ")
    return replace(model, priors=model.priors + priors, datum=words)


def _moved(start: Start, model: RotaryAxisModel) -> Start:
    theta = robust_start(assemble([model]).problem).theta
    s, first = start.stations.size, len(model.own) + 6 * len(model.table.nodes)
    targets = theta[first : first + start.targets.size].reshape(-1, 3)
    return replace(start, stations=start.stations + theta[:s].reshape(-1, 3), targets=start.targets + targets)


def _places(entries: Sequence[StationSetup | Target], start: Array) -> list[Parameter]:
    """Coordinates of stations or targets, counted from first estimates (k, 3), m."""
    pairs = zip(entries, start, strict=True)
    return [place_of(entry.id, axis, float(place[j])) for entry, place in pairs for j, axis in enumerate("xyz")]


def _model(session: Session, table: TableReadings, start: Start) -> RotaryAxisModel:
    description = session.description.as_a(RotaryAxis)
    arm = table.turned(start.targets)
    away = arm - start.stations[table.readings.setup]
    path = np.linalg.norm(away, axis=1)
    g = away / path[:, None]
    observations = Observations(session, table.readings, arm, g, g, path, table.run)
    places = _places(description.targets, start.targets)
    nominal = stated_places(session)[1]
    k = len(table.nodes)
    columns = np.zeros((6 * k + nominal.size, len(g)))
    _fill(columns, table, g, arm, np.zeros_like(g))
    terms = []
    for j, (name, unit) in enumerate(zip(table.motions, ("m", "m", "m", "rad", "rad", "rad"), strict=True)):
        values = tuple(motion_value(name, node, unit) for node in table.nodes)
        terms.append(Term(name, values, columns[j * k : (j + 1) * k]))
    labels = [[parameter.name for parameter in term.parameters] for term in terms]
    terms.append(Term("targets", tuple(places), columns[6 * k :]))
    size = float(np.sqrt(np.mean(np.sum(nominal**2, axis=1)))) or 1.0
    unsensed = datum.unsensed_motions(table, g, arm, size)
    seen = np.isin(np.arange(len(nominal)), table.target)
    constraints = datum.motion_constraints(table, labels, unsensed, size)
    constraints += datum.target_constraints(table.direction, [p.name for p in places], nominal, start.targets, seen)
    return RotaryAxisModel(
        observations=observations,
        terms=tuple(terms),
        constraints=tuple(constraints),
        priors=datum.unseen_motions(unsensed, labels, size),
        left_out=(),
        datum=datum.ROTARY_DATUM,
        table=table,
        stations=start.stations,
        targets=start.targets,
        unsensed=unsensed,
        size=size,
    )


_STEPS = 20


def line_names(axis: str) -> tuple[tuple[str, int], ...]:
    """ISO 230-1 names of an axis average line's errors and their places among (X, Y, Z, A, B, C): X0C Y0C A0C B0C."""
    along = "ABC".index(axis)
    return tuple((f"{'XYZABC'[j]}0{axis}", j) for j in range(6) if j % 3 != along)


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
        "datum": datum.ROTARY_DATUM,
        "iso230_7": _error_motion_values(model, fit),
    }
    lost = tuple(NotDetermined(name, why) for name, _ in line_names(table.axis)) if why else ()
    return ErrorMap(content, points, error, uncertainty, cov, lost)


def _error_motion_values(model: RotaryAxisModel, fit: Fit) -> list[dict[str, Any]]:
    """Error motion values of ISO 230-7:2015, Clause 3: the range of each over the angles that tell it, U (95 %).

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
        told = {"kind": kind[along], "motion": name, "angles": len(mine), "value": value, "U": K * u}
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
    unseen = np.repeat(model.unsensed, t, axis=0) / np.repeat([1.0, model.size], 3)[:, None]
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
        declared = np.array([setups[s].position for s in known])
        uncertainty = np.array([setups[s].position_uncertainty for s in known])
        off = np.linalg.norm(off_declared(found, declared), axis=1)
        u = np.sqrt(uncertainty**2 + np.diag(covariance).reshape(-1, 3).sum(axis=1))
        worst = int(np.argmax(off / u))
        if off[worst] > _MISPLACED * u[worst]:
            name = setups[known[worst]].id
            why = say("undetermined.station_elsewhere", name=repr(name), off=f"{1e3 * off[worst]:.3g}")
        else:
            result = average_line(found, covariance, declared, uncertainty)
    out: dict[str, Any] = {}
    for name, j in line_names(model.table.axis):
        told = (None, None) if result is None else (float(result[0][j]), float(np.sqrt(result[1][j, j])))
        out[name], out[f"{name}_u"] = told
    return out, why
