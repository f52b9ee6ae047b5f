# SPDX-License-Identifier: Apache-2.0
"""From a session to the model of its step diagonals; angular errors from different orders of the moves.

To first order, with l the beam, d the nominal displacement since the start of the run, e the position error and t the
mirror's tilt (the normal is l + t, t across l), a reading n.d / (n.l) is

    l.d + l.(e - e_start) + t.d.

A rotation E of the tool against the workpiece (the sum of the angular errors of the axes) turns the mirror about the
functional point, which by then has moved by d off the beam's axis: the reading changes by E.(l x d), beside the
displacement E x arm that the same rotation gives the functional point.

Angular errors from the orders are as in Ibaraki and Hata 2010, Section 3.3, derived anew: the same move of one axis at
two places differs by angular errors only. With the start at (x0, y0, z0) and the chain w-Y-X-b-Z-t, those of each axis
change a reading by

    X: E.(l x (x - x0, y - y0, -z0))    Y: E.(l x (-x0, y - y0, -z0))    Z: E.(l x (x - x0, y - y0, z - z0))

(lever arm of Eq. (23) and rotation of the mirror together). What depends on one axis alone cannot be distinguished from
position errors; there remain EAX and ECX (through y) and EAZ, EBZ and ECZ (through x and y): five of nine, as the paper
has it. The mean of a slope is determined only if the mirror stayed as it was: a tilt set anew for each order looks the
same.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, orthonormal_basis
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.robust import robust_start
from machine_tool_calibration.estimation.solve import solve
from machine_tool_calibration.machine.error_motions import interpolation, parse_motion
from machine_tool_calibration.methods.step_diagonal import geometry
from machine_tool_calibration.methods.step_diagonal.model import DATUM, Spread, StepDiagonalModel
from machine_tool_calibration.methods.step_diagonal.model import error_map as error_map
from machine_tool_calibration.methods.step_diagonal.small_angles import LARGEST, NONE, SMALLEST, WAVES_NODES
from machine_tool_calibration.model import rigid_body
from machine_tool_calibration.model.model import (
    Constraint,
    Kind,
    NotDetermined,
    Parameter,
    Term,
    assemble,
    motion_value,
)
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.description import StepDiagonal
from machine_tool_calibration.session.session import Readings, Session
from machine_tool_calibration.words import say, together

_LEAST_SENSITIVITY = 1e-6  # m/m


def sensed_tables(
    tables: Sequence[rigid_body.MachineTable], blocks: Sequence[Array], observations: Observations
) -> tuple[tuple[rigid_body.MachineTable, ...], tuple[NotDetermined, ...]]:
    """Tables at those block positions at which a reading senses them, squareness as it is, and what none senses."""
    kept, left_out, position = [], [], observations.position
    for table in tables:
        if table.is_squareness:
            if np.abs(table.term(observations).columns).max() < 1e-12:
                left_out.append(NotDetermined(table.name, say("undetermined.no_reading")))
            else:
                kept.append(table)
            continue
        motion = parse_motion(table.name)
        axis, along = "XYZ".index(motion.axis), "XYZ".index(motion.component)
        sees = np.abs(observations.direction[:, along]) > _LEAST_SENSITIVITY
        # those that enter the interpolation by more than rounding
        nodes = np.abs(interpolation(blocks[axis], position[sees, axis])).max(axis=1, initial=0.0) > 1e-3
        moved = sees & (np.abs(position[:, axis] - blocks[axis][0]) > 0)
        if nodes.sum() < 2 or not moved.any():
            left_out.append(NotDetermined(table.name, say("undetermined.no_run_senses")))
            continue
        kept.append(rigid_body.MachineTable(table.chain, table.name, blocks[axis][nodes]))
    return tuple(kept), tuple(left_out)


def tilt_terms(
    runs: Sequence[geometry.Run], observations: Observations, displacement: Array, one_mirror: bool
) -> tuple[Term, ...]:
    """Terms `ppp.tilt` of two tilts, rad, for each setting of the mirror, which `one_mirror` keeps between orders.

    `ppp.tilt_1` is towards the horizontal direction across the beam, `ppp.tilt_2` towards the other
    (`geometry.across`). A tilt that no reading shows (a diagonal in a plane) is left out.
    """
    setup = observations.readings.setup
    settings: dict[str, list[int]] = {}
    for k, run in enumerate(runs):
        if run.diagonal:
            settings.setdefault(run.name if one_mirror else run.id, []).append(k)
    out = []
    for name, members in settings.items():
        mine = np.isin(setup, members)
        if not mine.any():
            continue
        columns, parameters = [], []
        for number, direction in enumerate(geometry.across(runs[members[0]].beam), start=1):
            column = np.where(mine, displacement @ direction, 0.0)
            if np.abs(column).max() > 1e-9:
                columns.append(column)
                parameters.append(Parameter(f"{name}.tilt_{number}", "rad", -0.02, 0.02, kind=Kind.TILT, owner=name))
        if columns:
            out.append(Term(f"{name}.tilt", tuple(parameters), np.array(columns)))
    return tuple(out)


# Share of the largest movement below which values that may move lie on a line.
_SAME_LINE = 1e-6


def second_order(
    runs: Sequence[geometry.Run], setup: IntArray, displacement: Array, error: Array, end_error: Array, tilt: Array
) -> Array:
    """(n,) exact minus first-order reading, m, at a first solution.

    From each reading's setup, nominal displacement (n, 3) and position error (n, 3) since the start of the run, the
    latter at the end of each run (runs, 3), m, and the mirror's tilt t (runs, 3) across the beam; for a linear run,
    whose beam lies on the actual motion, the tilt does not matter.
    """
    beam = np.array([run.beam for run in runs])
    actual = np.array([run.motion for run in runs]) + end_error
    length = np.linalg.norm(actual, axis=1)
    linear = np.array([not run.diagonal for run in runs])[:, None]
    off = end_error - np.einsum("rj,rj->r", end_error, beam)[:, None] * beam
    t = np.where(linear, off / length[:, None], tilt)
    stretch = (length - np.einsum("rj,rj->r", beam + t, actual)) / np.einsum("rj,rj->r", beam, actual)
    reached = displacement + error
    # For a diagonal t.d is of first order; in a linear run d lies along the beam and t.d is zero.
    return np.asarray(
        stretch[setup] * np.einsum("nj,nj->n", beam[setup], reached) + np.einsum("nj,nj->n", t[setup], error)
    )


_ONLY_SIZE = say("undetermined.only_size")
_ZERO = say("undetermined.taken_zero")
_RANDOM = say("datum.random_map", p=f"{NONE:g}", low=f"{1e6 * SMALLEST:g}", high=f"{1e6 * LARGEST:g}")


def build(session: Session, model: str = "small_angles") -> StepDiagonalModel:
    """The model of a step diagonal's session (Ibaraki and Hata 2010), by weighted least squares over all readings.

    Diagonals and linear runs in any number, orders and repeats; what they do not determine is found by the solver.
    A ModelError says that there are no readings, or a machine without the axes that move.
    """
    description = session.description.as_a(StepDiagonal)
    runs = geometry.runs_of(description)
    readings = session.readings.select(
        np.isfinite(session.readings.displacement) & np.isfinite(session.readings.position()).all(axis=1)
    )
    if not len(readings):
        raise ModelError(f"{session.source}: no reading to identify from")
    chain = description.machine.kinematics
    blocks = geometry.block_positions(description, readings)
    moved = {axis: nodes for axis, nodes in zip("XYZ", blocks, strict=True) if len(nodes) > 1}
    for axis in moved:
        if axis not in chain.linear:
            raise ModelError(f"the runs move {axis.lower()}, which the chain {description.machine.chain} does not have")
    candidates = rigid_body.linear_axis_errors(chain, moved)
    translations = [t for t in candidates if t.is_squareness or not t.is_rotation]
    rotations = [t for t in candidates if t.is_rotation and not t.is_squareness]
    observations, displacement = _observations(session, readings, runs)
    tables, left_out = sensed_tables(translations, blocks, observations)
    terms = tuple(table.term(observations) for table in tables)
    if model != "aligned_mirror":
        terms += tilt_terms(runs, observations, displacement, model == "angular_one_mirror")
    base = StepDiagonalModel(
        observations=observations,
        terms=terms,
        constraints=rigid_body.table_datum(tables),
        priors=(),
        left_out=left_out,
        datum=DATUM,
        runs=runs,
        blocks=blocks,
        tables=tables,
        angles=(),
        spread=None,
        nominal=observations.path,
        offsets=tuple(_offsets(session, readings)),
    )
    if not _complete(base, description.blocks):
        base = replace(base, constraints=_datum(base))
    base = replace(base, nominal=base.nominal + _second_order(base, displacement))
    if model in ("translations", "aligned_mirror"):
        return replace(base, left_out=base.left_out + tuple(NotDetermined(t.name, _ZERO) for t in rotations))
    return _with_spread(base, rotations) if model == "small_angles" else free_angles(base, rotations)


def _observations(session: Session, readings: Readings, runs: Sequence[geometry.Run]) -> tuple[Observations, Array]:
    """Readings by the direction that each senses, and displacements from the run's start: before it is dead path."""
    run = readings.repeat_of_setup
    position = readings.position()
    beam = np.array([r.beam for r in runs])[readings.setup]
    readings = readings.at_places(beam)
    displacement = position - np.array([r.start for r in runs])[readings.setup]
    path = np.einsum("nj,nj->n", beam, displacement)
    turned = np.asarray(np.cross(beam, displacement))
    observations = Observations(session, readings, position, beam, np.zeros_like(beam), path, run, turned)
    return observations, displacement


def _offsets(session: Session, readings: Readings) -> Iterator[Parameter]:
    for setup, repeat in np.unique(np.stack([readings.setup, readings.repeat]), axis=1).T.tolist():
        name = session.setup_ids[setup]
        yield Parameter(f"{name}.offset_{repeat}", "m", kind=Kind.RUN_OFFSET, owner=name, at=repeat)


def _complete(model: StepDiagonalModel, blocks: int) -> bool:
    """Whether every run that was made was read at as many places as its moves lead to."""
    setup = model.observations.readings.setup[np.unique(model.observations.run, return_index=True)[1]]
    planned = np.array([len(run.order) * blocks + 1 for run in model.runs])
    return bool((np.bincount(model.observations.run) >= planned[setup]).all())


def _datum(model: StepDiagonalModel) -> tuple[Constraint, ...]:
    """The tables' datum of the values that are determined: a lost last reading of a diagonal leaves some open."""
    assembly = assemble([model])
    undetermined = solve(assembly.problem).undetermined[assembly.places[0]]
    if not undetermined.size:
        return model.constraints
    place, placed = {parameter.name: k for k, parameter in enumerate(model.parameters)}, []
    for table in model.tables:
        own = undetermined[[place[label] for label in table.labels]]
        placed.append(_placed(table.nodes, own) if table.is_straightness else np.ones(len(own), dtype=bool))
    return rigid_body.table_datum(model.tables, placed)


def _placed(nodes: Array, undetermined: Array) -> BoolArray:
    """(k,) values of a table at nodes (k,) whose undetermined moves (k, r) lie on one line; all where no three do."""
    design = np.column_stack([np.ones(len(nodes)), nodes])
    most = float(np.abs(undetermined).max())

    def off_line(there: IntArray) -> float:
        lines, moves = design[there], undetermined[there]
        return float(np.abs(moves - lines @ np.linalg.pinv(lines) @ moves).max())

    there = np.arange(len(nodes))
    while off_line(there) > _SAME_LINE * most:
        if len(there) <= 3:
            return np.ones(len(nodes), dtype=bool)
        there = there[np.arange(len(there)) != np.argmin([off_line(np.delete(there, k)) for k in range(len(there))])]
    return np.isin(np.arange(len(nodes)), there)


def _second_order(model: StepDiagonalModel, displacement: Array) -> Array:
    """(n,) what the first-order readings leave out, at the solution of the first-order model."""
    assembly = assemble([model])
    # Gross errors have no say: their squares would bend the nominal path.
    theta = robust_start(assembly.problem).theta[assembly.places[0]]
    first, count = len(model.own), sum(len(table.labels) for table in model.tables)
    table_theta = theta[first : first + count]
    setup = model.observations.readings.setup
    start = np.array([run.start for run in model.runs])
    end = start + np.array([run.motion for run in model.runs])

    def error(at: Array) -> Array:
        return np.asarray(np.einsum("k,knj->nj", table_theta, rigid_body.map_field(model.tables, at)))

    at_start = error(start)
    moved = error(model.observations.position) - at_start[setup]
    return second_order(model.runs, setup, displacement, moved, error(end) - at_start, _tilts(model, theta))


def _tilts(model: StepDiagonalModel, theta: Array) -> Array:
    value = dict(zip([p.name for p in model.parameters], theta, strict=True))
    out = np.zeros((len(model.runs), 3))
    for k, run in enumerate(model.runs):
        for number, direction in enumerate(geometry.across(run.beam), start=1):
            own, shared = f"{run.id}.tilt_{number}", f"{run.name}.tilt_{number}"
            out[k] += value.get(own, value.get(shared, 0.0)) * direction
    return out


def _with_spread(base: StepDiagonalModel, rotations: list[rigid_body.MachineTable]) -> StepDiagonalModel:
    coarse = (
        replace(t, nodes=rigid_body.axis_nodes(base.blocks["XYZ".index(t.name[2])], WAVES_NODES)) for t in rotations
    )
    told = [(table, term) for table in coarse if np.abs((term := table.term(base.observations)).columns).max() > 1e-9]
    left_out = base.left_out + tuple(NotDetermined(t.name, _ONLY_SIZE) for t in rotations)
    if not told:
        return replace(base, left_out=left_out)
    own = []  # with unknowns of the session's own, not the machine's
    for table, term in told:
        names = (motion_value(table.name, node, "rad", shared=False, prefix="angle.") for node in table.nodes)
        own.append(Term(f"angle.{table.name}", tuple(names), term.columns))
    spread = Spread(tuple(table for table, _ in told), tuple(own))
    terms, words = base.terms + spread.terms, together((base.datum, _RANDOM), "; ")
    return replace(base, terms=terms, spread=spread, left_out=left_out, datum=words).reestimated()


# Share of a column's norm beside such functions below which it says nothing of its own.
_OWN_SHARE = 1e-3
# Share of an undetermined direction in the angular errors above which it is theirs.
_ANGULAR_SHARE = 1e-4


def angles_shown_by_orders(model: StepDiagonalModel, angles: Sequence[Term]) -> list[Term]:
    """Those that show beside any functions of single axes per diagonal, which hold all else: no assumption about it."""
    observations = model.observations
    n = len(observations)
    setup = observations.readings.setup
    names = [run.name for run in model.runs]
    family = np.array([names.index(name) for name in names])[setup]
    columns = [_indicators(observations.run)]
    for axis, nodes in enumerate(model.blocks):
        node = np.abs(observations.position[:, axis, None] - nodes[None]).argmin(axis=1)
        columns.append(_indicators(family * len(nodes) + node))
    columns += [term.columns for term in model.terms if term.name.endswith(".tilt")]
    basis = orthonormal_basis(np.concatenate(columns).T)
    out = []
    for angle in angles:
        norm = np.linalg.norm(angle.columns, axis=1)
        unit = angle.columns[norm > 1e-9 * np.sqrt(n)] / norm[norm > 1e-9 * np.sqrt(n), None]
        rest = unit - (unit @ basis) @ basis.T
        if len(unit) and np.linalg.norm(rest, axis=1).max() > _OWN_SHARE:
            out.append(angle)
    return out


def _indicators(group: IntArray) -> Array:
    """(groups, n) 1 where a reading is of a group."""
    return np.equal.outer(np.unique(group), group).astype(np.float64)


def free_angles(model: StepDiagonalModel, rotations: Sequence[rigid_body.MachineTable]) -> StepDiagonalModel:
    """The model with the angular errors that the orders of the moves determine as free tables; a ModelError if none."""
    own = (replace(table, nodes=model.blocks["XYZ".index(table.name[2])]) for table in rotations)
    candidates = {table.name: table for table in own}
    kept = angles_shown_by_orders(model, [table.term(model.observations) for table in candidates.values()])
    if not kept:
        orders = sorted({run.order for run in model.runs if run.diagonal})
        raise ModelError(
            f"angular errors need diagonals in several orders of the moves, such as ppp_xyz, ppp_yzx and ppp_zxy; "
            f"this session has {', '.join(orders) or 'no diagonal'}"
        )
    angles = tuple(candidates[term.name] for term in kept)
    lost = [table.name for table in rotations if candidates[table.name] not in angles]
    left_out = model.left_out + tuple(NotDetermined(name, say("undetermined.no_order")) for name in lost)
    terms, constraints = (*model.terms, *kept), model.constraints + rigid_body.table_datum(angles)
    full = replace(model, terms=terms, angles=angles, constraints=constraints, left_out=left_out)
    return _without_undetermined_slopes(full, model)


def _without_undetermined_slopes(full: StepDiagonalModel, base: StepDiagonalModel) -> StepDiagonalModel:
    """Take to be zero, and say so, the slopes that with tilts of mirrors set anew change no reading."""
    assembly = assemble([full])
    undetermined = solve(assembly.problem).undetermined[assembly.places[0]]
    angular = undetermined[len(base.parameters) :]
    _, s, vt = np.linalg.svd(angular.T, full_matrices=False)
    open_ones = vt[s > _ANGULAR_SHARE]
    if not len(open_ones):
        return full
    labels = [label for table in full.angles for label in table.labels]
    constraints = tuple(Constraint(dict(zip(labels, row, strict=True))) for row in open_ones.tolist())
    ends = np.cumsum([len(table.labels) for table in full.angles])[:-1]
    shares = np.split(np.abs(open_ones).max(axis=0), ends)
    sharing = [table.name for table, share in zip(full.angles, shares, strict=True) if share.max() > _ANGULAR_SHARE]
    lost = NotDetermined(f"{len(open_ones)} slopes of {', '.join(sharing)}", say("undetermined.slopes"))
    return replace(full, constraints=full.constraints + constraints, left_out=(*full.left_out, lost))
