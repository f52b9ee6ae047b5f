# SPDX-License-Identifier: Apache-2.0
"""Deviations read directly: an ISO 230-2 run, a straightedge, a grid encoder, a part measured on a CMM.

A reading is the deviation (actual minus commanded) of the functional point along a direction g; what the instrument
cannot know of it (an offset, or where the part lay) is unknown for every setup. The machine errors that the session
names enter as tables with straight lines between nodes, and squareness; what they cannot explain stays in the
residuals.

What a fit says of it are position errors, tables, and the figures of ISO 230-2 runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, groups, means_of, rigid_motions, rms, unsigned
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.methods.build import linear_part
from machine_tool_calibration.methods.direct import datum
from machine_tool_calibration.methods.direct.mistakes import refuse_mistakes
from machine_tool_calibration.methods.direct.nodes import asked_tables, bending_tables
from machine_tool_calibration.methods.direct.off_the_map import between_nodes, widened
from machine_tool_calibration.methods.iso230_2 import diagonal_tests, positioning_runs
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import (
    Constraint,
    Kind,
    MethodModel,
    NotDetermined,
    Parameter,
    Term,
    weight_row,
)
from machine_tool_calibration.model.observations import SAME_POSITION, Observations, first_states
from machine_tool_calibration.model.result import ErrorMap, determined_values
from machine_tool_calibration.model.rigid_body import (
    OPEN_CHANGE,
    MachineTable,
    determined_part,
    map_field,
    position_errors,
    read_nodes,
    table_datum,
    tables_content,
    unit_open,
    without_open,
)
from machine_tool_calibration.session.description import Direct
from machine_tool_calibration.session.session import Readings, Session, distinct_places
from machine_tool_calibration.words import say, together

# Unknowns that are solved within seconds; a plate of 40 x 40 places has as many.
_MOST_UNKNOWNS = 3200


@dataclass(frozen=True)
class PointErrors(MachineTable):
    """The position errors along one machine axis of all places that were read, each an unknown of its own.

    Its name is ex, ey or ez, and its nodes (k, 3) are the places, m.
    """

    is_rotation = is_straightness = False

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknowns, `ex(0.1, 0.2, 0)`."""
        names = (f"{self.name}({', '.join(f'{v:.6g}' for v in place + 0.0)})" for place in np.round(self.nodes, 9))
        return tuple(Parameter(name, "m", kind=Kind.POINTS, owner=self.name) for name in names)

    def field(self, position: Array) -> Array:
        """(n, 3) the axis's direction."""
        return np.repeat(np.eye(3)[["xyz".index(self.name[1])]], len(position), axis=0)

    def weights(self, position: Array) -> Array:
        """(k, n) 1 where a position is the place."""
        _, place = distinct_places(np.concatenate([self.nodes, position]))
        return np.equal.outer(place[: len(self.nodes)], place[len(self.nodes) :]).astype(np.float64)


def point_errors(chain: Chain, position: Array, sensed: BoolArray) -> tuple[PointErrors, ...]:
    """The errors of the places of readings (n, 3) along those axes that are `sensed` (3,); ModelError if too many."""
    places = position[distinct_places(position)[0]]
    axes = [axis for axis, seen in zip("xyz", sensed, strict=True) if seen]
    if len(places) * len(axes) > _MOST_UNKNOWNS:
        most, n = _MOST_UNKNOWNS // len(axes), len(places)
        raise ModelError(f"the model 'free' takes {most} places at most, and {n} were read: use rigid_body")
    return tuple(PointErrors(chain, f"e{axis}", places) for axis in axes)


def point_datum(points: tuple[PointErrors, ...], observed: Observations) -> Iterator[Constraint]:
    """No common shift or turn of all places, then none of those of a setup: what setups may leave open of them."""
    if not points:
        return
    places, setup = points[0].nodes, observed.readings.setup
    motions = rigid_motions(places - places.mean(axis=0))
    every = np.ones(len(places), dtype=bool)
    read = [np.asarray(points[0].weights(observed.position[setup == s]).any(axis=1)) for s in np.unique(setup)]
    for mine in (every, *read):
        for motion in np.where(mine[:, None, None], motions, 0.0).transpose(2, 0, 1):
            found = {
                parameter.name: float(moved)
                for one in points
                for parameter, moved in zip(one.parameters, motion[:, "xyz".index(one.name[1])], strict=True)
                if abs(moved) > 1e-12
            }
            if found:
                yield Constraint(found)


@dataclass(frozen=True)
class DirectModel(MethodModel):
    """Deviations with the errors that the session names."""

    tables: tuple[MachineTable, ...]  # the machine errors in the model, in the order of the first terms
    setups: datum.SetupDatum  # what each setup leaves open
    fixed: Array  # (unknowns, q) changes of the setups' and tables' unknowns that go unseen and that the datum fixes
    points: tuple[PointErrors, ...] = ()  # in place of tables, errors of every place by itself

    @property
    def own(self) -> tuple[Parameter, ...]:
        """What each setup leaves open."""
        return self.setups.parameters

    def part(self, own_index: IntArray, dense_index: IntArray) -> Part:
        """Every setup is a block."""
        readings = self.observations.readings
        reading = readings.displacement - self.setups.curvature
        places = own_index.reshape(len(self.observations.session.setup_ids), -1)
        return linear_part(self, readings.setup, reading, self.setups.columns, places, dense_index)


def build(session: Session, model: str = "rigid_body") -> DirectModel:
    """The model of a session of direct deviations: the machine errors that it names in `terms`, or `free` places.

    A ModelError says what is wrong: no reading, or readings that contradict the model in a way that a common mistake
    explains.
    """
    if not session.description.trust_units:
        refuse_mistakes(session, lambda seen: build_direct(seen, terms=()))
    return build_direct(session, free=model == "free")


def build_direct(session: Session, terms: Sequence[str] | None = None, *, free: bool = False) -> DirectModel:
    """The model, also with other machine errors (`terms`) than the session names; raises as `build`."""
    description = session.description.as_a(Direct)
    readings = _usable(session.readings)
    position = readings.position()
    direction = np.column_stack([readings.column(name) for name in ("gx", "gy", "gz")])
    length = np.linalg.norm(direction, axis=1)
    direction = direction / length[:, None]
    path = np.einsum("nj,nj->n", position, direction)
    asked, chain = description.terms if terms is None else tuple(terms), description.machine.kinematics
    still, rigid = np.zeros_like(direction), frozenset(asked)
    observations = Observations(session, readings, position, direction, still, path, readings.setup, rigid=rigid)
    setups = datum.setup_datum(description.datum, observations)
    # The one place of a drift's recording is off by something, which is no effect of the time.
    free |= terms is None and not asked and description.datum == "none" and not observations.moves
    made = partial(DirectModel, observations=observations, priors=(), setups=setups)
    if free:
        points = point_errors(chain, position, sensed_axes(direction))
        terms_of_points = tuple(one.term(observations) for one in points)
        constraints, fixed = _needed(list(point_datum(points, observations)), terms_of_points, setups, observations)
        said = setups.words
        if description.datum == "offset":
            place = distinct_places(position)[1]
            said = together((said, *datum.unconnected(observations, place)), "; ")
        return made(
            terms=terms_of_points, constraints=constraints, left_out=setups.left_out, datum=said, tables=(),
            fixed=fixed, points=points,
        )  # fmt: skip
    tables = bending_tables(asked_tables(chain, asked, position, _telling(session)), observations, setups)
    kept, machine, left = _sensed_terms(observations, tables)
    constraints, words, fixed = _datum(kept, machine, setups, observations)
    laid_down = {name for constraint in constraints for name in constraint.weights}
    unmoved = [table.name for table in kept if len(table.labels) == 1 and table.labels[0] in laid_down]
    if unmoved:  # nothing of them is left: their axis stood at one position, where the datum says 0
        left += tuple(NotDetermined(name, say("undetermined.one_position", axis=name[2])) for name in unmoved)
        kept = tuple(table for table in kept if table.name not in unmoved)
        machine = tuple(term for term in machine if term.name not in unmoved)
        constraints, words, fixed = _datum(kept, machine, setups, observations)
    said = together((setups.words, *words), "; ")
    return made(
        terms=machine, constraints=constraints, left_out=left + setups.left_out, datum=said, tables=kept, fixed=fixed
    )


def _usable(readings: Readings) -> Readings:
    needed = [readings.displacement, *(readings.column(name) for name in ("gx", "gy", "gz"))]
    needed += [readings.columns[axis] for axis in "xyz" if axis in readings.columns]
    usable = readings.select(np.flatnonzero(np.isfinite(np.array(needed)).all(axis=0)))
    if not len(usable):
        raise ModelError("no reading has a displacement, a direction and a position on each axis")
    return usable


def _telling(session: Session) -> int:
    """How many readings tell the tables apart, with those that were set aside.

    Of one axis all: its places are its nodes, and repeats check them. Where several move each place has nodes of its
    own in every table, so that only the number of places, in each direction that is sensed, checks a table.
    """
    readings = _usable(session.as_recorded.readings)
    position = readings.position()
    if np.count_nonzero(np.ptp(position, axis=0) > SAME_POSITION) < 2:
        return len(readings)
    sensed = unsigned(np.column_stack([readings.column(name) for name in ("gx", "gy", "gz")]))
    return int(groups(distinct_places(position)[1], *np.round(1e6 * sensed.T)).max()) + 1


def _sensed_terms(
    observations: Observations, tables: tuple[MachineTable, ...]
) -> tuple[tuple[MachineTable, ...], tuple[Term, ...], tuple[NotDetermined, ...]]:
    """The tables on which some reading depends; which of them cannot be distinguished is found by the solver."""
    kept, terms, left = [], [], []
    for table in tables:
        term = table.term(observations)
        if np.abs(term.columns).max(initial=0.0) < 1e-9:
            left.append(NotDetermined(table.name, say("undetermined.does_not_move")))
        else:
            kept.append(table)
            terms.append(term)
    return tuple(kept), tuple(terms), tuple(left)


def _datum(
    tables: tuple[MachineTable, ...], terms: tuple[Term, ...], setups: datum.SetupDatum, observed: Observations
) -> tuple[tuple[Constraint, ...], list[str], Array]:
    """Zeros and slopes of tables, as many as the readings leave open: straightness first, positioning last."""
    ordered = sorted(tables, key=lambda table: (not table.is_straightness, not table.is_rotation))
    read = {term.name: read_nodes(term.columns) for term in terms}
    candidates = [constraint for table in ordered for constraint in table_datum((table,), (read[table.name],))]
    # Of a rotation with one lever arm the slope is a turn of the whole frame.
    candidates += [
        Constraint(dict(zip(table.labels, (table.nodes - table.nodes.mean()).tolist(), strict=True)))
        for table in ordered
        if table.is_rotation and not table.is_squareness and len(table.labels) > 1
    ]
    needed, fixed = _needed(candidates, terms, setups, observed)
    zero = [next(iter(c.weights)) for c in needed if len(c.weights) == 1]
    slope = [next(iter(c.weights)).split("(")[0] for c in needed if len(c.weights) > 1]
    words = [f"{', '.join(zero)} = 0"] if zero else []
    words += [say("datum.from_line", names=", ".join(slope))] if slope else []
    return needed, words, fixed


def _needed(
    candidates: Sequence[Constraint], terms: tuple[Term, ...], setups: datum.SetupDatum, observed: Observations
) -> tuple[tuple[Constraint, ...], Array]:
    """Those conditions that fix what the readings leave open, and the (unknowns, q) changes that they fix."""
    columns = np.concatenate([setups.of_each(observed), *(term.columns for term in terms)])
    basis, scale = datum.silent_directions(columns)
    names = [p.name for p in setups.parameters] + [q.name for term in terms for q in term.parameters]
    place = {name: k for k, name in enumerate(names)}
    chosen, fixed = datum.needed_rows(basis, [weight_row(place, c.weights, len(names)) * scale for c in candidates])
    return tuple(candidates[k] for k in chosen), fixed * scale[:, None]


_OPEN = {"none": "tables", "offset": "offsets", "rigid": "shifts"}
# Share of the sum of squares from which scatter and reversal are all of it.
_ALL = 0.95
# Component of a unit direction below which a reading does not sense an axis: a beam that is a little off it.
_ACROSS = 1e-2
# Share of the range of readings by which a point may be beyond it.
_BEYOND = 1e-3


def sensed_axes(direction: Array) -> BoolArray:
    """(3,) which machine axes any of the unit directions (n, 3) has a component along."""
    return np.asarray(np.abs(direction).max(axis=0, initial=0.0) > _ACROSS)


def sensed_at(points: Array, position: Array, direction: Array) -> BoolArray:
    """(m, 3) machine axes along which readings sense the errors at points (m, 3).

    As far as their positions (n, 3) reach along every axis: what a run along Z does across itself no run along X says.
    """
    out = np.zeros((len(points), 3), dtype=bool)
    for axis in range(3):
        own = position[np.abs(direction[:, axis]) > _ACROSS]
        if len(own):
            low, high = own.min(axis=0), own.max(axis=0)
            margin = SAME_POSITION + _BEYOND * (high - low)
            out[:, axis] = ((points >= low - margin) & (points <= high + margin)).all(axis=1)
    return out


def error_map(model: DirectModel, fit: Fit) -> ErrorMap:
    """The contract's content for `direct`.

    What the setups' unknowns leave open is taken out of the position errors by least squares over the points, so that
    neither the errors nor their uncertainties hinge on a single node. A direction that no reading senses at a point is
    NaN: a term or an effect may move it, but nothing was measured there.
    """
    observations, tables, setups = model.observations, model.tables or model.points, model.setups
    own, n = len(setups.parameters), len(observations)
    # Terms of added effects follow those of the tables; of them only displacements count. What is not sensed has no
    # part in the map's least squares, and distinguishes no states of an effect.
    sensed = sensed_at(observations.position, observations.position, observations.direction)
    terms = model.terms[len(tables) :]
    effects = [np.zeros((len(t.parameters), n, 3)) if t.field is None else t.field * sensed for t in terms]
    first, state = first_states(observations.position, np.concatenate([np.zeros((0, n, 3)), *effects]))
    points = observations.position[first]
    # Many readings may be of few places.
    sensed = sensed[first]
    of_tables = map_field(tables, points) * sensed
    field = np.concatenate([of_tables, *(one[:, first] for one in effects)])
    ways = (observations.readings.columns.get(f"dir_{axis}", np.zeros(n)) for axis in "xyz")
    # 0 where it makes no difference, and the place was approached from either side
    approach = np.trunc([means_of(state, way)[first] for way in ways]) + 0.0
    flat = field.reshape(len(field), 3 * len(points))
    mine = slice(own, own + len(field))
    open_ones = fit.solution.undetermined_directions()[fit.places][mine]
    undetermined = np.linalg.norm(flat.T @ open_ones, axis=1).reshape(-1, 3) > OPEN_CHANGE
    inside = (sensed & ~undetermined).reshape(-1)
    common = _common(flat[: len(of_tables)].T @ model.fixed[own:], setups, points, observations.direction, sensed)
    common = unit_open(common, inside)
    parts = without_open(field, common, inside)
    error, covariance = position_errors(parts, fit.theta[mine], fit.covariance[mine, mine])
    # A restated fit says what other readings do, and these are off the map as they are.
    off = np.zeros(len(points))
    if fit.joint.given is None:
        bend = between_nodes(model.tables, fit.theta[mine], points)
        covariance, off = widened(covariance, bend, model, fit.residuals, state)
    # Where no term and no effect moves any place, nothing was asked of its error.
    error, uncertainty, covariance = determined_part(error, covariance, undetermined | ~sensed | (not field.any()))
    content: dict[str, Any] = {
        "points": points,
        "position_error": error,
        "position_error_u": uncertainty,
        "row": observations.readings.row[first],
        "approach": approach.T,
        "off_the_map": off,
        "spread_over_declared": float(np.sqrt(fit.joint.reduced_chi_square)),
        "absolute": setups.kind == "none",
        "datum": say(f"datum.nothing_of_{_OPEN[setups.kind]}") if common.shape[1] else setups.words,
    }
    if not model.points:
        content["tables"] = tables_content(model.tables, *(v[own:] for v in determined_values(fit)))
    # These are of the readings themselves: a restated fit changes nothing of them.
    if fit.joint.given is None:
        runs = positioning_runs(observations)
        content["scatter"] = _scatter(model, fit, runs)
        content |= ({"iso230_2": runs} if runs else {}) | diagonal_tests(observations)
    return ErrorMap(content, points, error, uncertainty, covariance)


def _scatter(model: DirectModel, fit: Fit, runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What the readings scatter about the model, what was declared, and on which the standard uncertainties rest.

    Where beside it only the reversal of ISO 230-2 runs is in it, also the scatter of one position and direction.
    """
    sigma, observations = model.declared_sigma, model.observations
    declared = rms(sigma) if np.ptp(sigma) > 0 else observations.session.sigma
    found = float(np.sqrt(fit.joint.reduced_chi_square)) * declared
    own: dict[str, Any] = {}
    if len(runs) == len(observations.session.setup_ids) and all(np.isfinite(run["B"]) for run in runs):
        squares, dof, reversal = _by_direction(runs)
        if dof and squares + reversal > _ALL * float(np.sum(fit.residuals**2)):
            p_value = float(special.chdtrc(dof, squares / declared**2))
            own = {"one_direction": float(np.sqrt(squares / dof)), "one_direction_p_value": p_value}
    return {
        **own,
        "declared": declared,
        "found": found,
        "uncertainties_from": "scatter" if fit.scatter_factor > 1.0 and found > declared else "declared",
        "factor": fit.scatter_factor,
    }


def _by_direction(runs: Sequence[Mapping[str, Any]]) -> tuple[float, int, float]:
    """Sum of squares about the means of a position and direction, its degrees of freedom, and that of the reversal."""
    squares, dof, reversal = 0.0, 0, 0.0
    for run in runs:
        up, down = run["count_up"], run["count_down"]
        dof += int((up - 1).clip(0).sum() + (down - 1).clip(0).sum())
        squares += float(np.nansum((up - 1) * run["s_up"] ** 2) + np.nansum((down - 1) * run["s_down"] ** 2))
        reversal += float(np.nansum(up * down / (up + down) * run["reversal"] ** 2))
    return squares, dof, reversal


def _common(tables: Array, setups: datum.SetupDatum, points: Array, direction: Array, sensed: BoolArray) -> Array:
    """(3 n, q) displacements of all points that the setups leave open, in the directions that are read (n, 3)."""
    n = len(points)
    parts = [tables]
    if setups.kind == "rigid":
        moved = rigid_motions(points - points.mean(axis=0))
        parts.append((moved * sensed[..., None]).reshape(3 * n, 6))
    elif setups.kind == "offset" and np.allclose(np.abs(direction @ direction[0]), 1.0, atol=1e-9):
        parts.append((direction[0] * sensed).reshape(3 * n, 1))
    return np.concatenate(parts, axis=1)
