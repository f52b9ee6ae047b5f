# SPDX-License-Identifier: Apache-2.0
"""One error map of several sessions."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, groups
from machine_tool_calibration.machine.error_motions import parse_motion
from machine_tool_calibration.methods.direct import off_the_map
from machine_tool_calibration.methods.direct.model import sensed_at
from machine_tool_calibration.methods.joint.between_nodes import between_nodes
from machine_tool_calibration.methods.joint.model import CommonModels
from machine_tool_calibration.methods.joint.small_angles import PublishedAngles
from machine_tool_calibration.model import rigid_body
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.model import Kind, NotDetermined
from machine_tool_calibration.model.observations import SAME_POSITION
from machine_tool_calibration.model.result import ErrorMap, determined_values
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say, together

_MOST_POINTS = 5000
# Share of a table's range by which a point may be beyond it, and displacement per unit that counts.
_BEYOND_TABLE = 1e-3
_MOVES = 1e-9
# Share of an undetermined unknown that others may have of it.
_ALONE = 1e-6


def joint_map(joint: JointFit, common: CommonModels, angles: PublishedAngles | None = None) -> ErrorMap:
    """Tables with their uncertainties, and position errors at the points of all sessions.

    What all readings together leave open is taken out of the position errors by least squares over the points.
    Where a component depends on a table beyond its nodes, which a session reached that does not determine it there,
    it has no value; where it depends on one between its nodes, what straight lines may be wrong by is in its
    uncertainty. A direction of the machine that no reading of any session senses at a point has no value either.
    """
    place = {parameter.name: k for k, parameter in enumerate(joint.assembly.parameters)}
    index = np.array([place[label] for table in common.tables for label in table.labels], dtype=np.int64)
    solution = joint.published
    values, uncertainties = (one[index] for one in determined_values(solution))
    content: dict[str, Any] = {"tables": rigid_body.tables_content(common.tables, values, uncertainties)}
    content |= _rotary(joint)
    if angles is not None:
        content |= {"angular_size": angles.size, "angular_probability": angles.probability}
    points = _points(joint, common)
    n = len(points)
    field = rigid_body.map_field(common.tables, points)
    beyond, lost = _beyond(common.tables, points)
    beyond |= ~_sensed(common, points)
    silent = solution.undetermined_directions()[index]
    inside = ~(beyond | _of_unread(field, silent)).reshape(-1)
    fixed = [common.fixed[label] for table in common.tables for label in table.labels]
    open_ = field.reshape(len(field), 3 * n).T @ np.array(fixed) if fixed else np.zeros((3 * n, 0))
    open_ = rigid_body.unit_open(open_, inside)

    field = rigid_body.without_open(field, open_, inside)
    theta, own = solution.theta[index], solution.covariance[np.ix_(index, index)]
    error, covariance = rigid_body.position_errors(field, theta, own)
    # A restated fit says what other readings do, and no reading does anything to the lines.
    if joint.given is None:
        for lines in between_nodes(common.tables, theta, own, points, solution.determined[index]):
            off = rigid_body.without_open(lines, open_, inside)
            covariance += np.einsum("kni,knj->nij", off, off)
        covariance, content["off_the_map"] = _widened(joint, points, covariance)
    moved = np.linalg.norm(np.einsum("kni,kq->niq", field, silent), axis=2)
    error, uncertainty, covariance = rigid_body.determined_part(
        error, covariance, (moved > rigid_body.OPEN_CHANGE) | beyond
    )
    content |= {"points": points, "position_error": error, "position_error_u": uncertainty, "datum": common.datum}
    return ErrorMap(content, points, error, uncertainty, covariance, lost)


def _widened(joint: JointFit, points: Array, covariance: Array) -> tuple[Array, Array]:
    """(n, 3, 3) covariances at points (n, 3), with what readings of the machine are off the map; (n,) that, m."""
    every, n = np.concatenate([covariance, np.zeros((1, 3, 3))]), len(points)  # the last of places without a point
    off = np.zeros(n + 1)
    for fit in joint.fits:
        position = fit.model.observations.position
        if spec_of(fit.model.observations.session).reads_machine:
            place = groups(*np.round(np.concatenate([points, position]) / SAME_POSITION).T)
            point = np.full(int(place.max()) + 1, n)
            point[place[:n]] = np.arange(n)
            every, own = off_the_map.widened(every, np.zeros((n + 1, 3)), fit.model, fit.residuals, point[place[n:]])
            off = np.maximum(off, own)
    return every[:n], off[:n]


def _of_unread(field: Array, silent: Array) -> BoolArray:
    """(n, 3) components of the position error that depend on a value of a table that no reading depends on.

    From the fields (K, n, 3) of the values, and the directions (K, q) that nothing determines. Such components say
    nothing of what is open: a shift of all places but these is not told from one of all.
    """
    basis, size, _ = np.linalg.svd(silent, full_matrices=False)
    basis = basis[:, size > _ALONE]  # others are of unknowns that are no table's
    unread = np.einsum("kq,kq->k", basis, basis) > 1.0 - _ALONE
    return np.asarray((np.abs(field[unread]) > _MOVES).any(axis=0))


def _sensed(common: CommonModels, points: Array) -> BoolArray:
    """(n, 3) machine axes along which some session senses the errors of the linear axes at points (n, 3)."""
    names = {table.name for table in common.tables}
    told = [m for m in common.models if any(term.name in names and term.columns.any() for term in m.terms)]
    position = np.concatenate([np.zeros((0, 3)), *(m.observations.position for m in told)])
    direction = np.concatenate([np.zeros((0, 3)), *(m.observations.direction for m in told)])
    return sensed_at(points, position, direction)


def _beyond(tables: Sequence[rigid_body.MachineTable], points: Array) -> tuple[BoolArray, tuple[NotDetermined, ...]]:
    """(n, 3) components of the position error that depend on a table beyond its nodes, and this in words."""
    out = np.zeros((len(points), 3), dtype=bool)
    names: dict[tuple[str, float, float], list[str]] = {}
    for table in tables:
        if table.is_squareness or len(table.nodes) < 2:
            continue
        axis = parse_motion(table.name).axis
        at, low, high = points[:, "XYZ".index(axis)], float(table.nodes[0]), float(table.nodes[-1])
        margin = _BEYOND_TABLE * (high - low)
        away = (at < low - margin) | (at > high + margin)
        moved = np.abs(rigid_body.map_field([replace(table, nodes=table.nodes[:1])], points)[0]) > _MOVES
        if (away[:, None] & moved).any():
            out |= away[:, None] & moved
            names.setdefault((axis.lower(), low, high), []).append(table.name)
    if not names:
        return out, ()
    ranges = [
        say("undetermined.range", names=", ".join(motions), axis=axis, low=f"{low:g}", high=f"{high:g}")
        for (axis, low, high), motions in names.items()
    ]
    why = say("undetermined.beyond", n=int(out.sum()), count=out.size, ranges=together(ranges, "; "))
    return out, (NotDetermined("error_map.position_error", why),)


def _points(joint: JointFit, common: CommonModels) -> Array:
    every = [m.observations.position for m in joint.assembly.models if getattr(m, "tables", None)]
    if not every or not common.tables:
        return np.zeros((0, 3))
    places = np.concatenate(every) + 0.0
    first = np.unique(np.round(places / SAME_POSITION), axis=0, return_index=True)[1]
    return np.asarray(places[first[:: -(-len(first) // _MOST_POINTS)]])


def _rotary(joint: JointFit) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for parameter, value, u in zip(joint.assembly.parameters, *determined_values(joint.published), strict=True):
        if parameter.shared and parameter.kind is Kind.MOTION and parse_motion(parameter.owner).axis in "ABC":
            entry = out.setdefault(parameter.owner, {"nodes": [], "value": [], "value_u": []})
            for key, one in (("nodes", parameter.at), ("value", value), ("value_u", u)):
                entry[key].append(one)
    return {"rotary": out} if out else {}
