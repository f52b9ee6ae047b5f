# SPDX-License-Identifier: Apache-2.0
"""Readings of a rotary axis against stations and targets as they are stated."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from machine_tool_calibration.arrays import Array, groups
from machine_tool_calibration.session.checks.mistakes import SENSES, UNITS, in_degrees, scaled, turned_round
from machine_tool_calibration.session.checks.nominal_geometry import (
    badly_exchanged,
    judged_by_worst,
    lines_of_sight,
    relative_misfit,
    turned,
)
from machine_tool_calibration.session.description import Place, RotaryAxis, rotary_column
from machine_tool_calibration.session.judgements import Judgement, Supposition
from machine_tool_calibration.session.session import Readings, Session, places_among

__all__ = ["nominal_rotary", "on_table", "turning_mistakes"]


def on_table(session: Session, readings: Readings) -> Array:
    """(n, 3) nominal position of each reading's target in the machine frame, m.

    Args:
        session: gives the sense of rotation, the targets and the axis under test.
        readings: give the target and the commanded angle.
    """
    description = session.description
    assert isinstance(description, RotaryAxis)
    column = rotary_column(description)
    target = places_among(readings.labels["target"], [entry.id for entry in description.targets])
    points = np.array([entry.position for entry in description.targets])[target]
    # the two coordinates that turn, in the order that makes a positive turn counter-clockwise seen from the axis's end
    first, second = {"a": (1, 2), "b": (2, 0), "c": (0, 1)}[column]
    angle = session.rotation_sign * readings.columns[column]
    points[:, [first, second]] = turned(points[:, [first, second]], angle)
    return points


def nominal_rotary(session: Session, place: Place) -> Iterator[Judgement]:
    """Judgements of a rotary axis."""
    exchanges = (badly_exchanged(session, _off_table, kind) for kind in ("setup", "target"))
    yield judged_by_worst(_off_table, itertools.chain(turning_mistakes(session), *exchanges))


def turning_mistakes(session: Session) -> Iterator[Supposition]:
    """Angles, senses and units of a rotary axis's session."""
    assert isinstance(session.description, RotaryAxis)
    column = rotary_column(session.description)
    yield in_degrees(session, f"the column {column} looks", column)
    yield turned_round(session, "the axis looks as if it turned the other way: check rotation_sign")
    yield from scaled(session, *UNITS, *SENSES)


def _off_table(session: Session) -> Array:
    """Displacements against the change of distance between station and turning target."""
    readings = session.readings
    path = np.linalg.norm(lines_of_sight(session, on_table(session, readings)), axis=1)
    return relative_misfit(session, path, groups(readings.setup, readings.repeat, readings.labels["target"]))
