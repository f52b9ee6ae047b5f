# SPDX-License-Identifier: Apache-2.0
"""Readings against the nominal geometry of their method, only as good as needed to see a mistake."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, groups
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.checks.mistakes import (
    Comparison,
    Mistake,
    exchanged,
    exchanged_axes,
    extent,
    per_setup,
    same,
    scaled,
    spread,
)
from machine_tool_calibration.session.description import (
    Place,
    Probing,
    RotaryAxis,
    StepDiagonal,
    TrackingInterferometer,
    rotary_column,
)
from machine_tool_calibration.session.session import Readings, Session

__all__ = [
    "check_index_angles",
    "compare_beam",
    "compare_diagonal",
    "compare_order",
    "compare_points",
    "compare_probing",
    "compare_rotary",
    "compare_tracking",
    "direction",
    "nominal_diagonal",
    "nominal_probing",
    "nominal_rotary",
    "nominal_tracking",
    "on_table",
    "places",
    "turned",
    "wrapped",
]


def direction(azimuth: Array, elevation: Array) -> Array:
    """(n, 3) unit vectors of a beam, machine frame; angles in rad."""
    flat = np.cos(elevation)
    return np.column_stack([np.cos(azimuth) * flat, np.sin(azimuth) * flat, np.sin(elevation)])


def places(labels: np.ndarray, ids: list[str]) -> IntArray:
    """(n,) place of each label in a list of ids."""
    table = {name: index for index, name in enumerate(ids)}
    unique, inverse = np.unique(labels, return_inverse=True)
    return np.array([table[str(name)] for name in unique], dtype=np.int64)[inverse]


def turned(points: Array, angle: Array) -> Array:
    """(n, 2) points turned counter-clockwise by angle (n,), rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.column_stack([cos * points[:, 0] - sin * points[:, 1], sin * points[:, 0] + cos * points[:, 1]])


def on_table(session: Session, description: RotaryAxis, target: IntArray, readings: Readings, unit: float) -> Array:
    """(n, 3) nominal position of each reading's target in the machine frame, m.

    Args:
        session: gives the sense of rotation.
        description: gives the targets and the axis under test.
        target: (n,) place of the target in the description.
        readings: give the commanded angle.
        unit: what the angle is multiplied with to be in rad.
    """
    column = rotary_column(description)
    points = np.array([entry.position for entry in description.targets])[target]
    # the two coordinates that turn, in the order that makes a positive turn counter-clockwise seen from the axis's end
    first, second = {"a": (1, 2), "b": (2, 0), "c": (0, 1)}[column]
    angle = unit * session.rotation_sign * readings.columns[column]
    points[:, [first, second]] = turned(points[:, [first, second]], angle)
    return points


def wrapped(angle: Array) -> Array:
    """The angle to the nearest turn, rad."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


_ORDER = re.compile(r"[_.-]([xyz]{3})$", re.IGNORECASE)


def compare_beam(description: TrackingInterferometer, readings: Readings) -> Comparison:
    """Commanded beam against the direction from the station to the target; misfits are angles, rad."""
    ids = [setup.id for setup in description.setups]
    stations = np.array([setup.position for setup in description.setups])
    upright = 0.0 if description.dimension == 2 else 1.0
    azimuth = readings.columns["azimuth"]
    elevation = upright * readings.columns.get("elevation", np.zeros(len(readings)))

    def judge(
        order: IntArray,
        unit: float = 1.0,
        sense: float = 1.0,
        about: tuple[float, float] = (1.0, 0.0),
        axes: tuple[int, int, int] = (0, 1, 2),
    ) -> Array:
        line = (readings.position()[:, axes] - stations[order][readings.setup]) * (1.0, 1.0, upright)
        beam = direction(about[0] * azimuth * unit + about[1], elevation * unit)
        cosine = np.sum(beam * line, axis=1) / np.linalg.norm(line, axis=1)
        return per_setup(readings.setup, np.arccos(np.clip(sense * cosine, -1, 1)), len(ids))

    itself = same(len(ids))
    now = judge(itself)

    def mistakes() -> Iterator[Mistake]:
        yield Mistake("azimuth and elevation look like degrees; angles are in radians", judge(itself, np.pi / 180), 1.0)
        yield Mistake("azimuth and elevation point from the target to the station", judge(itself, 1.0, -1.0), 1.0)
        what = "azimuth looks as if it was counted clockwise; it is counter-clockwise from +X, seen from +Z"
        yield Mistake(what, judge(itself, about=(-1.0, 0.0)), 1.0)
        yield Mistake("azimuth looks as if it was off by half a turn", judge(itself, about=(1.0, np.pi)), 1.0)
        for what, axes in exchanged_axes(description.dimension):
            yield Mistake(what, judge(itself, axes=axes), 1.0)
        yield from exchanged("setup", ids, now, 1.0, judge)

    return Comparison(now, 1.0, mistakes())


def compare_tracking(description: TrackingInterferometer, readings: Readings) -> Comparison:
    """Displacements against the change of distance between station and target, m."""
    ids = [setup.id for setup in description.setups]
    stations = np.array([setup.position for setup in description.setups])[:, : description.dimension]
    points = readings.position()[:, : description.dimension]
    measured, setup = readings.displacement, readings.setup

    def judge(difference: Array) -> Array:
        return spread(difference, setup, setup, len(ids))

    def path(
        order: IntArray,
        station_unit: float = 1.0,
        point_unit: float = 1.0,
        axes: tuple[int, int, int] = (0, 1, 2),
    ) -> Array:
        line = point_unit * points[:, axes[: description.dimension]] - station_unit * stations[order][setup]
        return np.asarray(np.linalg.norm(line, axis=1))

    itself = same(len(ids))
    predicted = path(itself)
    now, scale = judge(measured - predicted), extent(predicted, setup)

    def mistakes() -> Iterator[Mistake]:
        yield from scaled(measured, predicted, scale, judge)
        for what, units in (("the stations' positions look", (1e-3, 1.0)), ("x, y and z look", (1.0, 1e-3))):
            other = path(itself, *units)
            message = f"{what} like millimetres; lengths are in metres"
            yield Mistake(message, judge(measured - other), extent(other, setup))
        for what, axes in exchanged_axes(description.dimension):
            yield Mistake(what, judge(measured - path(itself, axes=axes)), scale)
        yield from exchanged("setup", ids, now, scale, lambda order: judge(measured - path(order)))

    return Comparison(now, scale, mistakes())


def compare_diagonal(description: StepDiagonal, readings: Readings) -> Comparison:
    """Displacements and positions against the runs' nominal lines, m."""
    ids = [setup.id for setup in description.setups]
    start = np.array([setup.start for setup in description.setups])
    direction = np.array([setup.direction for setup in description.setups])
    motion = direction * np.asarray(description.step) * description.blocks
    beam = motion / np.linalg.norm(motion, axis=1)[:, None]
    points, setup, measured = readings.position(), readings.setup, readings.displacement
    group = groups(setup, readings.repeat)

    def judge(difference: Array, order: IntArray, points: Array = points) -> Array:
        low = np.minimum(start, start + motion)[order][setup]
        high = np.maximum(start, start + motion)[order][setup]
        outside = np.linalg.norm(np.clip(low - points, 0, None) + np.clip(points - high, 0, None), axis=1)
        return spread(difference, group, setup, len(ids)) + per_setup(setup, outside, len(ids))

    def path(order: IntArray, points: Array = points) -> Array:
        which = order[setup]
        return np.asarray(np.sum(beam[which] * (points - start[which]), axis=1))

    itself = same(len(ids))
    predicted = path(itself)
    now, scale = judge(measured - predicted, itself), extent(predicted, group)

    def mistakes() -> Iterator[Mistake]:
        yield from scaled(measured, predicted, scale, lambda difference: judge(difference, itself))
        for what, axes in exchanged_axes(3):
            other = points[:, axes]
            yield Mistake(what, judge(measured - path(itself, other), itself, other), scale)
        yield from exchanged("setup", ids, now, scale, lambda order: judge(measured - path(order), order))

    return Comparison(now, scale, mistakes())


def compare_order(description: StepDiagonal, readings: Readings) -> Comparison:
    """Positions against those at which a diagonal halts if its moves are in the order that its id states, m."""
    ids = [setup.id for setup in description.setups]
    points, setup = readings.position(), readings.setup
    halts = [_halts(description, index) for index in range(len(ids))]

    def judge(order: IntArray) -> Array:
        off = np.zeros(len(points))
        for index, other in enumerate(order):
            mine = setup == index
            if halts[other] is not None and mine.any():
                off[mine] = np.linalg.norm(points[mine][:, None] - halts[other], axis=2).min(axis=1)
        # The two thirds of the halts at which one order differs from another decide, not the middle one.
        return np.array([off[setup == k].mean() if np.any(setup == k) else np.nan for k in range(len(ids))])

    itself = same(len(ids))
    now, scale = judge(itself), min(description.step)
    return Comparison(now, scale, exchanged("setup", ids, now, scale, judge))


def nominal_tracking(session: Session, readings: Readings, place: Place) -> Iterator[Comparison]:
    """Comparisons of a tracking interferometer."""
    description = session.description
    assert isinstance(description, TrackingInterferometer)
    if description.pointing == "open_loop":
        yield compare_beam(description, readings)
    yield compare_tracking(description, readings)


def nominal_diagonal(session: Session, readings: Readings, place: Place) -> Iterator[Comparison]:
    """Comparisons of a step diagonal."""
    description = session.description
    assert isinstance(description, StepDiagonal)
    yield compare_diagonal(description, readings)
    yield compare_order(description, readings)


def nominal_rotary(session: Session, readings: Readings, place: Place) -> Iterator[Comparison]:
    """Comparisons of a rotary axis."""
    description = session.description
    assert isinstance(description, RotaryAxis)
    yield compare_rotary(session, description, readings)


def nominal_probing(session: Session, readings: Readings, place: Place) -> Iterator[Comparison]:
    """Comparisons of a probing.

    Raises:
        SessionError: the column c and the setups' c are different angles.
    """
    description = session.description
    assert isinstance(description, Probing)
    check_index_angles(description, readings, place)
    yield compare_probing(session, description, readings)
    yield compare_points(session, description, readings)


def _halts(description: StepDiagonal, index: int) -> Array | None:
    """(3 blocks + 1, 3) positions of a diagonal whose id states the order of its moves; None for others."""
    run = description.setups[index]
    found = _ORDER.search(run.id)
    if run.kind != "diagonal" or found is None or sorted(found[1].lower()) != ["x", "y", "z"]:
        return None
    moves = np.zeros((3 * description.blocks + 1, 3))
    for place, letter in enumerate(found[1].lower()):
        axis = "xyz".index(letter)
        moves[1 + place :: 3, axis] = run.direction[axis] * description.step[axis]
    return np.asarray(np.asarray(run.start) + np.cumsum(moves, axis=0))


_SAME_ANGLE = 0.01  # rad


def compare_rotary(session: Session, description: RotaryAxis, readings: Readings) -> Comparison:
    """Displacements against the change of distance between station and turning target, m."""
    ids, setup, measured = session.setup_ids, readings.setup, readings.displacement
    names = [entry.id for entry in description.targets]
    stations = np.array([entry.position for entry in description.setups])
    target = places(readings.labels["target"], names)
    group = groups(setup, readings.repeat, target)

    def judge(predicted: Array) -> Array:
        return spread(measured - predicted, group, setup, len(ids))

    def path(order: IntArray, unit: float = 1.0, which: IntArray = target) -> Array:
        points = on_table(session, description, which, readings, unit)
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
    bad = np.flatnonzero(np.abs(wrapped(c - expected)) > _SAME_ANGLE)
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
        return bool(np.all(np.abs(wrapped(one - other)) < _SAME_ANGLE))

    if agree(np.radians(c), expected):
        return "; the column c looks like degrees; angles are in radians"
    if agree(c, np.radians(expected)):
        return "; the setups' c look like degrees; angles are in radians"
    if agree(-c, expected):
        return "; the sign is opposite: check rotation_sign"
    off = np.abs(wrapped(c[first] - declared))
    if off.min() < _SAME_ANGLE:
        return f"; this is the angle of setup {ids[int(np.argmin(off))]!r}: are setups exchanged?"
    return ""


def compare_probing(session: Session, description: Probing, readings: Readings) -> Comparison:
    """Commanded positions against the nominal points of the turned workpiece, m."""
    index = places(readings.labels["point"], [point.id for point in description.workpiece])
    points = np.array([point.position for point in description.workpiece])
    commanded = readings.position()[:, :2]
    scale = float(np.max(np.linalg.norm(points, axis=1), initial=0.0))

    def judge(turn: Array, sense: float = 1.0, commanded: Array = commanded) -> Array:
        expected = turned(points[index], sense * session.rotation_sign * turn)
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
    index = places(readings.labels["point"], ids)
    points = np.array([point.position for point in description.workpiece])
    back = turned(readings.position()[:, :2], -session.rotation_sign * readings.columns["c"])
    scale = float(np.max(np.linalg.norm(points, axis=1), initial=0.0))

    def judge(order: IntArray) -> Array:
        off = np.linalg.norm(back - points[order][index], axis=1)
        return per_setup(index, np.asarray(off), len(ids))

    now = judge(same(len(ids)))
    return Comparison(now, scale, exchanged("point", ids, now, scale, judge))
