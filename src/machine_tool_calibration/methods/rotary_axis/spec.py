# SPDX-License-Identifier: Apache-2.0
"""The rotary axis by multilateration: its traits, and readings against stations and targets as they are stated."""

import itertools
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, groups
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.methods.rotary_axis.geometry import axis_rotation
from machine_tool_calibration.session.checks import nominal_geometry
from machine_tool_calibration.session.checks.mistakes import SENSES, UNITS, in_degrees, scaled, turned_round
from machine_tool_calibration.session.description import Place, RotaryAxis
from machine_tool_calibration.session.judgements import Judgement, Supposition
from machine_tool_calibration.session.method import MethodSpec
from machine_tool_calibration.session.session import Readings, Session, distinct_places, places_among
from machine_tool_calibration.words import figures


class RotarySpec(MethodSpec):
    """A rotary axis by sequential multilateration."""

    description = RotaryAxis
    model = "machine_tool_calibration.methods.rotary_axis.model"
    models: ClassVar = {"free": "the only one: six error motions at every angle, targets and stations unknown"}
    turns_one_axis = counts_from_run = True
    steps = "machine_tool_calibration.procedure.steps:rotary_steps"
    further_places = "machine_tool_calibration.planning.places:further_stations"
    planned = "machine_tool_calibration.planning.forecast:to_table"
    pictures = "machine_tool_calibration.plots.rotary_axis"

    def columns(self, description: RotaryAxis) -> tuple[str, ...]:
        """The target and the angle of the axis under test."""
        return ("setup", "repeat", "target", description.machine.table_axis.lower(), "displacement")

    def enough(self, session: Session, measured: BoolArray, place: Place) -> None:
        """Stations, targets and angles.

        A SessionError: two stations at one place, too few stations or readings, all stations on a line.
        """
        description = session.description.as_a(RotaryAxis)
        nominal_geometry.enough_stations(session, description.setups, measured, place, needed=3, method=session.method)
        _refuse_one_plane(description, place)
        _enough_angles(session, description, measured, place)

    def nominal(self, session: Session, place: Place) -> Iterator[Judgement]:
        """Judgements of a rotary axis."""
        exchanges = (nominal_geometry.badly_exchanged(session, _off_table, kind) for kind in ("setup", "target"))
        yield nominal_geometry.judged_by_worst(_off_table, itertools.chain(turning_mistakes(session), *exchanges))


SPEC = RotarySpec()

# Slope of the steepest line of sight to the plane across the axis, below which heights and tilts do not show.
_FLAT = 0.01


def _refuse_one_plane(description: RotaryAxis, place: Place) -> None:
    along = "abc".index(description.machine.table_axis.lower())
    stations, targets = (np.array([one.position for one in some]) for some in (description.setups, description.targets))
    sight = stations[:, None] - targets
    height = np.abs(sight[..., along])
    if (height < _FLAT * np.linalg.norm(sight, axis=2)).all():
        raise SessionError(
            f"{place.description}: stations and targets stand in one plane across the axis, to "
            f"{figures(1e3 * float(height.max()))} mm: no distance between them shows heights or tilts; put a station "
            "or a target a tenth of the distance off that plane"
        )


def _enough_angles(session: Session, description: RotaryAxis, measured: BoolArray, place: Place) -> None:
    readings = session.readings
    ids = [target.id for target in description.targets]
    used = [i for i, name in enumerate(ids) if np.any(readings.labels["target"][measured] == name)]
    straight = nominal_geometry.on_a_line(np.array([description.targets[i].position for i in used]))
    angle = readings.columns[description.machine.table_axis.lower()][measured]
    first, at_angle = distinct_places(angle[:, None])
    angles = len(first)
    count = len(np.unique(readings.setup[measured]))
    different = len(np.unique(groups(readings.labels["target"][measured], readings.setup[measured], at_angle)))
    # the table moves as a rigid body; one or two targets show three or five of its six motions. At each angle but the
    # first that many unknowns, three per target and station, a path for each pair of them; minus the frame
    # (with one target: 3 n + 13, Zhang et al. 2015)
    per_angle = 3 if len(used) == 1 else 5 if straight else 6
    unknown = per_angle * (angles - 1) + 3 * len(used) + (3 + len(used)) * count - 6
    if count < 4 and straight:
        seen = "one target" if len(used) == 1 else "two targets" if len(used) == 2 else "targets on a line"
        raise SessionError(
            f"{place.readings}: {seen} from {count} stations leave the places of the stations open; "
            "measure a third target off the line, or from a fourth station"
        )
    if different < unknown:
        most = max(len(np.unique(at_angle[readings.setup[measured] == s])) for s in readings.setup[measured])
        advice = "measure more angles"
        if most < angles:
            advice = f"no station was read at more than {most} of them: are the angles of all stations the same?"
        raise SessionError(
            f"{place.readings}: too few readings: {different} different ones at {angles} angles "
            f"for {unknown} unknowns; {advice}"
        )


def on_table(session: Session, readings: Readings) -> Array:
    """(n, 3) nominal position of each reading's target at its commanded angle in the machine frame, m."""
    description = session.description.as_a(RotaryAxis)
    column = description.machine.table_axis.lower()
    target = places_among(readings.labels["target"], [entry.id for entry in description.targets])
    points = np.array([entry.position for entry in description.targets])[target]
    rotation = axis_rotation(column.upper(), session.rotation_sign * readings.columns[column])
    return np.asarray(np.einsum("nij,nj->ni", rotation, points))


def turning_mistakes(session: Session) -> Iterator[Supposition]:
    """Angles, senses and units of a rotary axis's session."""
    column = session.description.machine.table_axis.lower()
    yield in_degrees(session, f"the column {column} looks", column)
    yield turned_round(session, "the axis looks as if it turned the other way: check rotation_sign")
    yield from scaled(session, *UNITS, *SENSES)


def _off_table(session: Session) -> Array:
    readings = session.readings
    path = np.linalg.norm(nominal_geometry.lines_of_sight(session, on_table(session, readings)), axis=1)
    return nominal_geometry.relative_misfit(
        session, path, groups(readings.setup, readings.repeat, readings.labels["target"])
    )
