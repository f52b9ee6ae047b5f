# SPDX-License-Identifier: Apache-2.0
"""One error map of several sessions, and what its straight lines between nodes may be wrong by."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.machine.error_motions import off_a_line, parse_motion
from machine_tool_calibration.methods.direct.model import sensed_axes
from machine_tool_calibration.methods.joint.model import CommonModels, tables_of
from machine_tool_calibration.methods.joint.small_angles import PublishedAngles
from machine_tool_calibration.model import rigid_body
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.model import Kind, NotDetermined
from machine_tool_calibration.model.result import ErrorMap, determined_values
from machine_tool_calibration.words import say, together

# Positions equal to the micrometre are one.
_DIGITS = 6


def between_nodes(
    tables: Sequence[rigid_body.MachineTable],
    theta: Array,
    covariance: Array,
    points: Array,
    read: Mapping[str, Array],
    known: BoolArray | None = None,
) -> Array:
    """(n, 3, 3) covariance of the position error at points (n, 3) from the tables' straight lines, m^2.

    From the values (K,) of the tables and their covariance. What a line is wrong by shows in the residuals where a
    session that senses the table has `read` (by its name, positions, m), and beyond its nodes there is none. Only
    values that are `known` (K,) show a bend, and only between two that stand next to each other is there a line.
    """
    out = np.zeros((len(points), 3, 3))
    first = 0
    for table in tables:
        mine = slice(first, first + len(table.labels))
        first = mine.stop
        good = np.ones(len(table.labels), dtype=bool) if known is None else known[mine]
        if table.is_squareness or good.sum() < 3:
            continue
        at, nodes = points[:, "XYZ".index(parse_motion(table.name).axis)], table.nodes
        right, lever = off_a_line(nodes, at)
        seen = read.get(table.name, np.empty(0))
        lever[np.isin(np.round(at, _DIGITS), np.round(seen, _DIGITS))] = 0.0
        if lever.max(initial=0.0) <= 1e-3 * float(np.ptp(nodes)) ** 2 / len(nodes) ** 2:
            continue
        moved = rigid_body.map_field([replace(table, nodes=nodes[:1])], points)[0]
        bend = squared_bend(nodes[good], theta[mine][good], covariance[mine, mine][np.ix_(good, good)])
        variance = np.where(good[right - 1] & good[right], lever**2 * bend, 0.0)
        out += variance[:, None, None] * moved[:, :, None] * moved[:, None, :]
    return out


def squared_bend(nodes: Array, value: Array, covariance: Array) -> float:
    """Mean square of the second derivative of values (k,) at nodes (k,), less what their covariance adds to it."""
    step = np.diff(nodes)
    k = len(nodes)
    slope = (np.eye(k)[1:] - np.eye(k)[:-1]) / step[:, None]
    second = 2 * np.diff(slope, axis=0) / (step[1:] + step[:-1])[:, None]
    noise = np.einsum("ik,kl,il->i", second, covariance, second)
    found = (second @ value) ** 2
    # A motion bends alike all over; where nodes are close together its bend is lost in the uncertainty.
    weight = 1.0 / np.maximum(noise, 1e-6 * float(noise.max(initial=1e-300))) ** 2
    return max(float(weight @ (found - noise) / weight.sum()), 0.0)


_MOST_POINTS = 5000
# Share of a table's range by which a point may be beyond it, and displacement per unit that counts.
_BEYOND_TABLE = 1e-3
_MOVES = 1e-9


def joint_map(joint: JointFit, common: CommonModels, angles: PublishedAngles | None = None) -> ErrorMap:
    """Tables with their uncertainties, and position errors at the points of all sessions.

    What all readings together leave open is taken out of the position errors by least squares over the points.
    Where a component depends on a table beyond its nodes, which a session reached that does not determine it there,
    it has no value; where it depends on one between its nodes, what straight lines may be wrong by is in its
    uncertainty. A direction of the machine that no reading of any session senses has no value either.
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
    flat = field.reshape(len(field), 3 * n)
    beyond, lost = _beyond(common.tables, points)
    beyond |= ~_sensed(common)
    inside = ~beyond.reshape(-1)
    fixed = [common.fixed[label] for table in common.tables for label in table.labels]
    open_ = flat.T @ np.array(fixed) if fixed else np.zeros((3 * n, 0))
    size = np.linalg.norm(open_[inside], axis=0)
    open_ = open_[:, size > 1e-9] / size[size > 1e-9]
    if open_.shape[1]:
        flat = flat - (open_ @ np.linalg.lstsq(open_[inside], flat.T[inside], rcond=1e-9)[0]).T
    theta, own = solution.theta[index], solution.covariance[np.ix_(index, index)]
    error, covariance = rigid_body.position_errors(flat.reshape(len(field), n, 3), theta, own)
    # A restated fit says what other readings do, and no reading does anything to the lines.
    if joint.given is None:
        covariance += between_nodes(common.tables, theta, own, points, _read(common), solution.determined[index])
    moved = np.linalg.norm(flat.T @ solution.undetermined_directions()[index], axis=1).reshape(n, 3)
    error, uncertainty, covariance = rigid_body.determined_part(
        error, covariance, (moved > rigid_body.OPEN_CHANGE) | beyond
    )
    content |= {"points": points, "position_error": error, "position_error_u": uncertainty, "datum": common.datum}
    return ErrorMap(content, points, error, uncertainty, covariance, lost)


def _sensed(common: CommonModels) -> BoolArray:
    """(3,) machine axes along which some session senses the errors of the linear axes."""
    names = {table.name for table in common.tables}
    told = [m for m in common.models if any(term.name in names and term.columns.any() for term in m.terms)]
    directions = [m.observations.direction for m in told]
    return sensed_axes(np.concatenate([np.zeros((0, 3)), *directions]))


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


def _read(common: CommonModels) -> dict[str, Array]:
    """By name of a table, the positions on its axis at which a session that senses it has read."""
    out = {}
    for table in common.tables:
        if not table.is_squareness:
            axis = "XYZ".index(parse_motion(table.name).axis)
            told = [m for m in common.models if table.name in {own.name for own in tables_of(m)}]
            every = [np.empty(0), *(m.observations.position[:, axis] for m in told)]
            out[table.name] = np.unique(np.concatenate(every))
    return out


def _points(joint: JointFit, common: CommonModels) -> Array:
    every = [m.observations.position for m in joint.assembly.models if getattr(m, "tables", None)]
    if not every or not common.tables:
        return np.zeros((0, 3))
    points = np.unique(np.round(np.concatenate(every), 9) + 0.0, axis=0)
    step = -(-len(points) // _MOST_POINTS)
    return np.asarray(points[::step])


def _rotary(joint: JointFit) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for parameter, value, u in zip(joint.assembly.parameters, *determined_values(joint.published), strict=True):
        if parameter.shared and parameter.kind is Kind.MOTION and parse_motion(parameter.owner).axis in "ABC":
            entry = out.setdefault(parameter.owner, {"nodes": [], "value": [], "value_u": []})
            for key, one in (("nodes", parameter.at), ("value", value), ("value_u", u)):
                entry[key].append(one)
    return {"rotary": out} if out else {}
