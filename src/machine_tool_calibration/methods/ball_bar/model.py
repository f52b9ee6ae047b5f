# SPDX-License-Identifier: Apache-2.0
"""What a ball bar should read: radial deviation by centre, length, squareness and the difference of the scales.

With u the unit vector from the centre to the tool, a displacement e of the tool changes the reading by u.e, an offset c
of the centre by -u.c, and a bar that is longer than stated by -1 (ISO 230-4:2005; Knapp 1983). The mean scale of the
axes cannot be distinguished from the bar's length; differences of the scales can.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.machine.error_motions import SQUARENESS
from machine_tool_calibration.methods.ball_bar.circle import arms, in_plane, way_over_time
from machine_tool_calibration.methods.ball_bar.iso230_4 import circular_tests, contributions
from machine_tool_calibration.methods.build import linear_part
from machine_tool_calibration.model import rigid_body
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import Kind, MethodModel, NotDetermined, Parameter, Term
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.result import ErrorMap, determined_values
from machine_tool_calibration.session.description import BallBar
from machine_tool_calibration.session.session import Readings, Session, distinct_places
from machine_tool_calibration.words import say


@dataclass(frozen=True)
class CircleModel(MethodModel):
    """Centre and length of the bar in every setup; squareness and difference of the scales of the machine."""

    tables: tuple[rigid_body.MachineTable, ...]  # squareness errors of the planes that were measured
    scales: str  # letters of the axes whose scales are compared, the first one the reference
    second_order: Array  # (n,) what the offset of the centre adds to its first order, m

    @property
    def own(self) -> tuple[Parameter, ...]:
        """Offset of the centre along the plane's two axes, and excess length of the bar."""
        setups = self.observations.session.description.as_a(BallBar).setups
        return tuple(
            Parameter(f"{setup.id}.{what}", "m", kind=Kind.OFFSET, owner=setup.id, meaning=meaning)
            for setup in setups
            for what, meaning in (
                *((f"centre_{axis.lower()}", say("unknown.centre", setup=setup.id)) for axis in setup.plane),
                ("length", say("unknown.bar_length", setup=setup.id)),
            )
        )

    def part(self, own_index: IntArray, dense_index: IntArray) -> Part:
        """Every setup is a block."""
        seen = self.observations
        _, plane = arms(seen.session.description.as_a(BallBar), seen.readings)
        block = -np.concatenate([in_plane(seen.direction, plane).T, np.ones((1, len(seen)))])
        reading = seen.readings.displacement - self.second_order
        return linear_part(self, seen.readings.setup, reading, block, own_index.reshape(-1, 3), dense_index)


def build(session: Session, model: str = "circle") -> CircleModel:
    """The model of a session of circles, of which at least one was read."""
    description = session.description.as_a(BallBar)
    readings = session.readings.select(np.flatnonzero(np.isfinite(session.readings.displacement)))
    readings = _with_feed(description, readings)
    position = readings.position()
    arm, plane = arms(description, readings)
    flat = np.zeros_like(arm)
    np.put_along_axis(flat, plane, in_plane(arm, plane), axis=1)
    direction = flat / np.linalg.norm(flat, axis=1)[:, None]
    radius = np.array([setup.radius for setup in description.setups])[readings.setup]
    seen = Observations(session, readings, position, direction, np.zeros_like(direction), radius, readings.setup)
    chain = description.machine.kinematics
    planes = dict.fromkeys(setup.plane for setup in description.setups)
    squareness = {frozenset(axes): name for name, axes in SQUARENESS.items()}
    tables = tuple(rigid_body.MachineTable(chain, squareness[frozenset(plane)], np.empty(0)) for plane in planes)
    scales = "".join(sorted({axis for name in planes for axis in name}))
    terms = [table.term(seen) for table in tables]
    terms += [
        Term(p.name, (p,), seen.sense(field[None]))
        for p, field in zip(_mismatches(scales), _mismatch_field(scales, position), strict=True)
    ]
    return CircleModel(
        observations=seen,
        terms=tuple(terms),
        constraints=(),
        priors=(),
        left_out=(NotDetermined("mean_scale", say("undetermined.bar_length")),),
        datum=say("datum.ball_bar"),
        tables=tables,
        scales=scales,
        second_order=_second_order(seen, plane),
    )


def _with_feed(description: BallBar, readings: Readings) -> Readings:
    """The readings with the path speed that the setups state, or way over time, where no column has it."""
    if "feed" in readings.columns:
        return readings
    feed = np.array([setup.feed or np.nan for setup in description.setups])[readings.setup]
    made = way_over_time(readings)
    feed = np.where(np.isfinite(feed), feed, made)
    return replace(readings, columns={**readings.columns, "feed": feed}) if np.isfinite(feed).all() else readings


def _mismatches(scales: str) -> tuple[Parameter, ...]:
    """Scale of every other axis less that of the first."""
    meaning = {axis: say("unknown.scale_difference", axis=axis, first=scales[0]) for axis in scales[1:]}
    return tuple(
        Parameter(f"scale_{axis}_less_{scales[0]}".lower(), "1", shared=True, kind=Kind.SQUARENESS, meaning=what)
        for axis, what in meaning.items()
    )


def _mismatch_field(scales: str, position: Array) -> Array:
    """(k, n, 3) displacement per unit of each difference of scales; their mean, which the bar takes up, is zero."""
    axes = np.array(["XYZ".index(axis) for axis in scales])
    scale = np.zeros((len(axes) - 1, 3))
    scale[:, axes] = np.eye(len(axes))[1:] - 1.0 / len(axes)
    return np.asarray(scale[:, None, :] * position)


def _second_order(seen: Observations, plane: IntArray) -> Array:
    """|arm - c| - |arm| + u.c of the centre's best offset c: 0.1 mm beside a radius of 150 mm are 33 nm."""
    out = np.zeros(len(seen))
    for index in np.unique(seen.readings.setup):
        mine = seen.readings.setup == index
        unit = in_plane(seen.direction[mine], plane[mine])
        columns = -np.column_stack([unit, np.ones(len(unit))])
        arm = seen.path[mine, None] * unit
        for _ in range(3):
            offset = np.linalg.lstsq(columns, seen.readings.displacement[mine] - out[mine], rcond=1e-6)[0][:2]
            out[mine] = np.linalg.norm(arm - offset, axis=1) - seen.path[mine] + unit @ offset
    return out


def error_map(model: CircleModel, fit: Fit) -> ErrorMap:
    """Position errors by squareness and difference of scales, from the machine's zero; figures of ISO 230-4."""
    seen, own = model.observations, len(model.own)
    points = seen.position[distinct_places(seen.position)[0]]
    field = np.concatenate([rigid_body.map_field(model.tables, points), _mismatch_field(model.scales, points)])
    mine = slice(own, own + len(field))
    error, covariance = rigid_body.position_errors(field, fit.theta[mine], fit.covariance[mine, mine])
    open_ones = fit.solution.undetermined_directions()[fit.places][mine]
    undetermined = np.linalg.norm(np.einsum("kq,knd->qnd", open_ones, field), axis=0) > rigid_body.OPEN_CHANGE
    undetermined |= ~np.isin(np.arange(3), ["XYZ".index(axis) for axis in model.scales])
    error, uncertainty, covariance = rigid_body.determined_part(error, covariance, undetermined)
    theta, sigma = determined_values(fit)
    content: dict[str, Any] = {
        "points": points,
        "position_error": error,
        "position_error_u": uncertainty,
        "tables": rigid_body.tables_content(model.tables, theta[own:], sigma[own:]),
        "datum": model.datum,
    }
    # These are of the readings themselves: a restated fit changes nothing of them.
    if fit.joint.given is None:
        u = fit.scatter_factor * model.sigma
        content["figures"], content["circles"] = circular_tests(seen, model.second_order, u)
        content["figures"] += contributions(fit, model.terms, own)
    return ErrorMap(content, points, error, uncertainty, covariance)
