# SPDX-License-Identifier: Apache-2.0
"""The probing of a part on a rotary table: its traits, and touches against the part as it is described."""

import itertools
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, first_true, groups
from machine_tool_calibration.errors import SessionError, suspected
from machine_tool_calibration.session.checks import mistakes
from machine_tool_calibration.session.checks.nominal_geometry import (
    badly_exchanged,
    counted,
    judged_by_worst,
    turned,
    wrapped,
)
from machine_tool_calibration.session.checks.units import FINEST, LARGEST_MACHINE, MILLIMETRES
from machine_tool_calibration.session.description import Description, Place, Probing
from machine_tool_calibration.session.judgements import GROSS, Held, Judgement
from machine_tool_calibration.session.method import MethodSpec
from machine_tool_calibration.session.session import Session, places_among

# Where a part may lie beside its nominal place, m and share of its radius; where most touches are at their points to
# this, by how much the others may be beside theirs, m; and how much of a normal lies along an axis that the probe
# approaches along it.
_PART_BESIDE, _RADII, _ALONG = 0.02, 0.2, 0.3
_AT_POINT, _TOUCH_BESIDE = 1e-4, 2e-3
# Share of a setup's touches with an approach against their normals from which on the normals are wrong.
_AGAINST = 0.5
_SAME_ANGLE = 0.01  # rad
# A measured length, over how far the touches reach, that is another unit; share of the touches within a table's grid.
_BEYOND_TOUCHES, _IN_GRID = 20.0, 0.5
# Nodes of the tables from which more unknowns than touches (two position errors a node) take minutes.
_MANY_NODES, _AT_A_NODE = 100, 2


class ProbingSpec(MethodSpec):
    """A part on a rotary table, probed at several angles of C."""

    description = Probing
    always = ("setup", "repeat", "point", "x", "y", "c", "displacement")
    remounted = ""
    model = "machine_tool_calibration.methods.probing.model"
    models: ClassVar = {
        "rigid_body": "the only one: the part has a form of its own, the axes are rigid bodies with tables of errors"
    }
    turned_part = ("the probe", ("probe_pretravel",))
    reads_deviations = probes_surface = True
    steps = "machine_tool_calibration.procedure.steps:touch_steps"
    further_places = "machine_tool_calibration.planning.places:further_angles"
    planned = "machine_tool_calibration.planning.forecast:touching"
    pictures = "machine_tool_calibration.plots.probing"

    def enough(self, session: Session, measured: BoolArray, place: Place) -> None:
        """Angles of C and touches."""
        used = np.unique(session.readings.setup[measured])
        if len(used) < 2:
            raise SessionError(
                f"{place.readings}: touches at {counted(len(used), 'C angle')}; probing needs at least 2 "
                "to distinguish the workpiece from the machine"
            )
        grid = session.description.machine.table_grid or {}
        nodes = sum(len(places) for axis, places in grid.items() if axis.lower() in "xy")
        touches = int(np.count_nonzero(measured))
        if nodes > _MANY_NODES and _AT_A_NODE * nodes > touches:
            raise SessionError(
                f"{place.description}: table_grid has {nodes} nodes, which are {_AT_A_NODE * nodes} unknown errors of "
                f"the axes at least, and there are {touches} touches: give fewer nodes, or leave it out"
            )
        super().enough(session, measured, place)

    def magnitudes(self, session: Session, place: Place) -> None:
        """Refuse normals that are none, a stylus, a measured length and a grid that cannot be."""
        description = session.description.as_a(Probing)
        _check_known(session, place)
        _check_grid(session, place)
        for index, point in enumerate(description.workpiece):
            length = float(np.hypot(*point.normal))
            if abs(length - 1.0) > 0.01:
                where = f"{place.description}: workpiece[{index}].normal"
                raise SessionError(f"{where}: the normal of point {point.id!r} has length {length:g}, not 1")
        if description.probe is not None and description.probe.stylus_diameter > 0.1 and not description.trust_units:
            diameter = description.probe.stylus_diameter
            with suspected():
                raise SessionError(f"{place.description}: probe.stylus_diameter is {diameter:g} m; {MILLIMETRES}")

    def nominal(self, session: Session, place: Place) -> Iterator[Judgement]:
        """Judgements of a probing; a SessionError if the column c and the setups' c are different angles."""
        _check_index_angles(session, place)
        way = "the workpiece looks as if it turned the other way: check machine.rotation_sign"
        exchanged = badly_exchanged(session, _off_workpiece, "setup")
        others = itertools.chain([mistakes.turned_round(session, way)], mistakes.exchanged_axes(session, 2), exchanged)
        yield judged_by_worst(_off_workpiece, others)
        yield judged_by_worst(_off_workpiece, badly_exchanged(session, _off_workpiece, "point"), by="point")

    def held(self, session: Session) -> Iterator[Held]:
        """Touches against the part as it is described and turned: where they are, and from which side."""
        readings = session.readings
        off = np.linalg.norm(readings.position()[:, :2] - _turned_part(session, "position"), axis=1)
        # Where the touches are at their points, one that is not is at another point: no reading tells that.
        near = bool(np.median(off) < _AT_POINT)
        beside = _TOUCH_BESIDE if near else max(_PART_BESIDE, _RADII * _radius(session))
        share = 0.0 if near else GROSS
        sense = [readings.columns.get(f"dir_{axis}", np.zeros(len(readings))) for axis in "xy"]
        normal = _turned_part(session, "normal")
        along = np.where(np.abs(normal) > _ALONG, np.column_stack(sense) * np.sign(normal), 0.0)
        against = (along > 0.0).any(axis=1) & (along >= 0.0).all(axis=1)
        touched = "the point that was to be touched, as workpiece, c and rotation_sign place it"
        left = "the outward normal, along which a probe leaves the part"
        for label, group in (("point", groups(readings.labels["point"])), ("", None)):
            owner: dict[str, Any] = {"label": label, "group": group}
            yield Held("the place (x, y)", touched, off, np.full(len(off), beside), share=share, **owner)
            owner |= {"unit": "", "share": _AGAINST, "hint": lambda setup: "are the normals of workpiece reversed?"}
            yield Held("the approach (dir_x, dir_y)", left, against.astype(float), np.full(len(off), 0.5), **owner)


SPEC = ProbingSpec()


def _off_workpiece(session: Session) -> Array:
    """Commanded positions against the nominal points of the workpiece, turned as the setups say; in its radii."""
    off = np.linalg.norm(session.readings.position()[:, :2] - _turned_part(session, "position"), axis=1)
    return np.asarray(off / _radius(session))


def _radius(session: Session) -> float:
    return max(float(np.hypot(*point.position)) for point in session.description.as_a(Probing).workpiece)


def _turned_part(session: Session, key: str) -> Array:
    """(n, 2) nominal position or normal of each touched point, turned as its setup says."""
    description, readings = session.description.as_a(Probing), session.readings
    index = places_among(readings.labels["point"], [point.id for point in description.workpiece])
    vectors = np.array([getattr(point, key) for point in description.workpiece])[index]
    return turned(vectors, session.rotation_sign * _declared(description)[readings.setup])


def _declared(description: Description) -> Array:
    return np.array([setup.c for setup in description.as_a(Probing).setups])


def _check_known(session: Session, place: Place) -> None:
    for name, entry in session.description.as_a(Probing).known.items():
        where, u = f"{place.description}: known.{name}", entry.standard_uncertainty
        if name not in ("EXX", "EYY"):
            raise SessionError(f"{where} is not the positioning error of a probing axis; EXX and EYY are")
        if 0.0 < u < FINEST:
            raise SessionError(f"{where}.standard_uncertainty is {u:g} m, less than any instrument has; 0 is exact")
        reach = float(np.abs(session.readings.column(name[-1].lower())).max())
        if abs(entry.position) > _BEYOND_TOUCHES * reach and not session.description.trust_units:
            with suspected():
                raise SessionError(
                    f"{where}.position is {entry.position:g} m, and touches reach to {reach:g} m; {MILLIMETRES}"
                )


def _check_grid(session: Session, place: Place) -> None:
    """A grid that holds too few of the touches would be filled by straight lines from outside it."""
    grid = {} if session.description.trust_units else session.description.machine.table_grid or {}
    for name, nodes in ((name, nodes) for name, nodes in grid.items() if name.lower() in session.readings.columns):
        where, position = f"{place.description}: machine.table_grid.{name}", session.readings.column(name.lower())
        low, high, reach = float(position.min()), float(position.max()), max(map(abs, nodes))
        with suspected():
            if reach > LARGEST_MACHINE:
                raise SessionError(f"{where} reaches {reach:g} m; {MILLIMETRES}")
            inside = np.mean((position >= nodes[0]) & (position <= nodes[-1]))
            if inside < _IN_GRID and max(abs(low), abs(high)) <= LARGEST_MACHINE:
                raise SessionError(
                    f"{where} runs from {nodes[0]:g} to {nodes[-1]:g} m, and the touches are at {low:g} to {high:g} m"
                )


def _check_index_angles(session: Session, place: Place) -> None:
    """The column c and the setup's c must be the same angle: a SessionError names the first row where they are not."""

    def off(session: Session) -> Array:
        expected = _declared(session.description)[session.readings.setup]
        return np.abs(wrapped(session.readings.columns["c"] - expected))

    readings, setups, declared = session.readings, session.description.setups, _declared(session.description)
    bad = first_true(off(session) > _SAME_ANGLE)
    if bad is None:
        return
    row, setup, c = readings.row[bad], readings.setup[bad], readings.columns["c"][bad]
    radians = tuple(one.model_copy(update={"c": np.radians(c)}) for one, c in zip(setups, declared, strict=True))
    suppositions = (
        mistakes.in_degrees(session, "the column c looks", "c"),
        mistakes.described(session, "the setups' c look like degrees; angles are in radians", setups=radians),
        mistakes.with_columns(session, "the sign is opposite: check rotation_sign", c=-readings.columns["c"]),
    )
    judgement = Judgement(lambda s: float(off(s).max()), suppositions, _SAME_ANGLE, _SAME_ANGLE)
    what = mistakes.explanation(session, [judgement])
    near = np.abs(wrapped(c - declared))
    if what is None and near.min() < _SAME_ANGLE:
        what = f"this is the angle of setup {setups[int(near.argmin())].id!r}: are setups exchanged?"
    raise SessionError(
        f"{place.row(row)}: c is {c:g} rad and setup {setups[setup].id!r} stands at {declared[setup]:g} rad"
        + (f"; {what}" if what else "")
    )
