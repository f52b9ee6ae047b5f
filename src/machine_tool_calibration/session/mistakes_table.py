"""Targets and workpieces on a rotary table against their nominal geometry."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session import nominal
from machine_tool_calibration.session.description import Probing, RotaryAxis
from machine_tool_calibration.session.mistakes import (
    Comparison,
    Mistake,
    exchanged,
    exchanged_axes,
    extent,
    groups,
    per_setup,
    same,
    scaled,
    spread,
)
from machine_tool_calibration.session.place import Place
from machine_tool_calibration.session.session import Readings, Session

__all__ = ["check_index_angles", "compare_points", "compare_probing", "compare_rotary"]

_SAME_ANGLE = 0.01  # rad


def compare_rotary(session: Session, description: RotaryAxis, readings: Readings) -> Comparison:
    """Displacements against the change of distance between station and turning target, m."""
    ids, setup, measured = session.setup_ids, readings.setup, readings.displacement
    names = [entry.id for entry in description.targets]
    stations = np.array([entry.position for entry in description.setups])
    target = nominal.places(readings.labels["target"], names)
    group = groups(setup, readings.repeat, target)

    def judge(predicted: Array) -> Array:
        return spread(measured - predicted, group, setup, len(ids))

    def path(order: IntArray, unit: float = 1.0, which: IntArray = target) -> Array:
        points = nominal.on_table(session, description, which, readings, unit)
        return np.asarray(np.linalg.norm(points - stations[order][setup], axis=1))

    itself = same(len(ids))
    predicted = path(itself)
    now, scale = judge(predicted), extent(predicted, group)

    def mistakes() -> Iterator[Mistake]:
        for what, unit in (
            ("the rotary axis's angles look like degrees; angles are in radians", np.pi / 180),
            ("the axis looks as if it turned the other way: check rotation_sign", -1.0),
        ):
            other = path(itself, unit)
            yield Mistake(what, judge(other), extent(other, group))
        yield from scaled(measured, predicted, scale, lambda difference: spread(difference, group, setup, len(ids)))
        yield from exchanged("setup", ids, now, scale, lambda order: judge(path(order)))
        by_target = spread(measured - predicted, group, target, len(names))
        yield from exchanged("target", names, by_target, scale, lambda order: judge(path(itself, which=order[target])))

    return Comparison(now, scale, mistakes())


def check_index_angles(description: Probing, readings: Readings, place: Place) -> None:
    """The column c and the setup's c must be the same angle.

    Raises:
        SessionError: the first row where they are not, with the suspicion.
    """
    setups = description.setups
    declared = np.array([setup.c for setup in setups])
    c, expected = readings.columns["c"], declared[readings.setup]
    bad = np.flatnonzero(np.abs(nominal.wrapped(c - expected)) > _SAME_ANGLE)
    if not len(bad):
        return
    first = int(bad[0])
    name = setups[readings.setup[first]].id
    raise SessionError(
        f"{place.row(readings.row[first])}: c is {c[first]:g} rad and setup {name!r} stands at {expected[first]:g} rad"
        + _angle_suspicion(c, expected, declared, first, [setup.id for setup in setups])
    )


def _angle_suspicion(c: Array, expected: Array, declared: Array, first: int, ids: list[str]) -> str:
    def agree(one: Array, other: Array) -> bool:
        return bool(np.all(np.abs(nominal.wrapped(one - other)) < _SAME_ANGLE))

    if agree(np.radians(c), expected):
        return "; the column c looks like degrees; angles are in radians"
    if agree(c, np.radians(expected)):
        return "; the setups' c look like degrees; angles are in radians"
    if agree(-c, expected):
        return "; the sign is opposite: check rotation_sign"
    off = np.abs(nominal.wrapped(c[first] - declared))
    if off.min() < _SAME_ANGLE:
        return f"; this is the angle of setup {ids[int(np.argmin(off))]!r}: are setups exchanged?"
    return ""


def compare_probing(session: Session, description: Probing, readings: Readings) -> Comparison:
    """Commanded positions against the nominal points of the turned workpiece, m."""
    index = nominal.places(readings.labels["point"], [point.id for point in description.workpiece])
    points = np.array([point.position for point in description.workpiece])
    commanded = readings.position()[:, :2]
    scale = float(np.max(np.linalg.norm(points, axis=1), initial=0.0))

    def judge(turn: Array, sense: float = 1.0, commanded: Array = commanded) -> Array:
        expected = nominal.turned(points[index], sense * session.rotation_sign * turn)
        off = np.linalg.norm(commanded - expected, axis=1)
        return per_setup(readings.setup, np.asarray(off), len(session.setup_ids))

    c = readings.columns["c"]
    now = judge(c)
    declared = np.array([setup.c for setup in description.setups])

    def mistakes() -> Iterator[Mistake]:
        what = "the workpiece looks as if it turned the other way: check machine.rotation_sign"
        yield Mistake(what, judge(c, -1.0), scale)
        for exchange, axes in exchanged_axes(2):
            yield Mistake(exchange, judge(c, commanded=commanded[:, axes[:2]]), scale)
        yield from exchanged(
            "setup", session.setup_ids, now, scale, lambda order: judge(declared[order][readings.setup])
        )

    return Comparison(now, scale, mistakes())


def compare_points(session: Session, description: Probing, readings: Readings) -> Comparison:
    """Commanded positions against the nominal ones, point by point, m."""
    ids = [point.id for point in description.workpiece]
    index = nominal.places(readings.labels["point"], ids)
    points = np.array([point.position for point in description.workpiece])
    back = nominal.turned(readings.position()[:, :2], -session.rotation_sign * readings.columns["c"])
    scale = float(np.max(np.linalg.norm(points, axis=1), initial=0.0))

    def judge(order: IntArray) -> Array:
        off = np.linalg.norm(back - points[order][index], axis=1)
        return per_setup(index, np.asarray(off), len(ids))

    now = judge(same(len(ids)))
    return Comparison(now, scale, exchanged("point", ids, now, scale, judge))
