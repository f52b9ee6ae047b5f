# SPDX-License-Identifier: Apache-2.0
"""Readings against the nominal geometry of their method, only as good as needed to see a mistake.

The nominal geometry predicts every reading to about the uncertainty of the stations. How far a reading is off is told
in shares of what is predicted, so that it does not depend on the unit.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, first_true, group_ranges, groups, unit_vectors
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.checks.mistakes import (
    LENGTHS,
    SENSES,
    UNITS,
    Judgement,
    Supposition,
    described,
    exchanged,
    exchanged_axes,
    explanation,
    in_degrees,
    scaled,
    turned_round,
    with_columns,
)
from machine_tool_calibration.session.description import (
    Description,
    Place,
    Probing,
    RotaryAxis,
    StepDiagonal,
    TrackingInterferometer,
    rotary_column,
)
from machine_tool_calibration.session.session import Readings, Session, places_among

__all__ = [
    "nominal_diagonal",
    "nominal_probing",
    "nominal_rotary",
    "nominal_tracking",
    "on_table",
    "turning_mistakes",
]


def turned(points: Array, angle: Array) -> Array:
    """(n, 2) points turned counter-clockwise by angle (n,), rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.column_stack([cos * points[:, 0] - sin * points[:, 1], sin * points[:, 0] + cos * points[:, 1]])


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


def wrapped(angle: Array) -> Array:
    """The angle to the nearest turn, rad."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


_ORDER = re.compile(r"[_.-]([xyz]{3})$", re.IGNORECASE)
_FITS = 0.1  # of what is predicted
_BETTER = 0.2  # of the misfit as it is

Off = Callable[[Session], Array]
"""Of a session, (n,) how far each reading is off, in shares of what is predicted."""


def _judgement(off: Off, suppositions: Iterable[Supposition], by: str = "setup") -> Judgement:
    """By the setup or point whose readings are the furthest off."""

    def misfit(session: Session) -> float:
        return float(np.nanmax(_by(session, off, by)[1], initial=0.0))

    return Judgement(misfit, suppositions, absurd=_FITS, good=_FITS, better=_BETTER)


def _exchanged(session: Session, off: Off, kind: str) -> Iterator[Supposition]:
    """Exchanges of two setups, targets or points that do not fit as they are."""
    ids, misfit = _by(session, off, kind)
    yield from exchanged(session, kind, [name for name, one in zip(ids, misfit, strict=True) if one > _FITS])


def _by(session: Session, off: Off, kind: str) -> tuple[list[str], Array]:
    """Ids of the setups, targets or points, and for each how far its readings are off in the middle; NaN for none."""
    readings, key = session.readings, {"target": "targets", "point": "workpiece"}.get(kind, "setups")
    ids = [entry.id for entry in getattr(session.description, key)]
    which = readings.setup if kind == "setup" else places_among(readings.labels[kind], ids)
    return ids, group_ranges(off(session), which, len(ids))[1]


def _relative(session: Session, predicted: Array, group: IntArray) -> Array:
    """(n,) how far displacements are off a prediction (n,), m, each group having a zero of its own.

    As a share of half the prediction's range in a group.
    """
    difference = session.readings.displacement - predicted
    zero = group_ranges(difference, group, int(group.max(initial=-1)) + 1)[1]
    return np.asarray(np.abs(difference - zero[group]) / _extent(predicted, group))


def _extent(predicted: Array, group: IntArray) -> float:
    low, _, high = group_ranges(predicted, group, int(group.max(initial=-1)) + 1)
    known = np.isfinite(low)
    return float(np.median((high - low)[known])) / 2 if known.any() else np.nan


def nominal_tracking(session: Session, place: Place) -> Iterator[Judgement]:
    """Judgements of a tracking interferometer."""
    description = session.description
    assert isinstance(description, TrackingInterferometer)
    if description.pointing == "open_loop":
        yield _judgement(_off_beam, _beam_mistakes(session, description.dimension))
    yield _judgement(_off_path, _path_mistakes(session, description))


def _off_beam(session: Session) -> Array:
    """Commanded beam against the direction from the station to the target, rad."""
    description, readings = session.description, session.readings
    assert isinstance(description, TrackingInterferometer)
    upright = 0.0 if description.dimension == 2 else 1.0
    elevation = upright * readings.columns.get("elevation", np.zeros(len(readings)))
    beam = unit_vectors(readings.columns["azimuth"], elevation)
    line = _lines(session, readings.position()) * (1.0, 1.0, upright)
    cosine = np.sum(beam * line, axis=1) / np.linalg.norm(line, axis=1)
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)))


def _beam_mistakes(session: Session, dimension: int) -> Iterator[Supposition]:
    azimuth = session.readings.columns["azimuth"]
    elevation = session.readings.columns.get("elevation", np.zeros(len(azimuth)))
    yield in_degrees(session, "azimuth and elevation look", "azimuth", "elevation")
    what = "azimuth and elevation point from the target to the station"
    yield with_columns(session, what, azimuth=azimuth + np.pi, elevation=-elevation)
    what = "azimuth looks as if it was counted clockwise; it is counter-clockwise from +X, seen from +Z"
    yield with_columns(session, what, azimuth=-azimuth)
    yield with_columns(session, "azimuth looks as if it was off by half a turn", azimuth=azimuth + np.pi)
    yield from exchanged_axes(session, dimension)
    yield from _exchanged(session, _off_beam, "setup")


def _off_path(session: Session) -> Array:
    """Displacements against the change of distance between station and target."""
    assert isinstance(session.description, TrackingInterferometer)
    line = _lines(session, session.readings.position())[:, : session.description.dimension]
    return _relative(session, np.linalg.norm(line, axis=1), session.readings.setup)


def _path_mistakes(session: Session, description: TrackingInterferometer) -> Iterator[Supposition]:
    yield from scaled(session, *UNITS, *SENSES)
    setups = [
        setup.model_copy(update={"position": tuple(1e-3 * v for v in setup.position)}) for setup in description.setups
    ]
    yield described(session, f"the stations' positions look {LENGTHS}", setups=tuple(setups))
    metres = dict(zip("xyz", 1e-3 * session.readings.position().T, strict=True))
    yield with_columns(session, f"x, y and z look {LENGTHS}", **metres)
    yield from exchanged_axes(session, description.dimension)
    yield from _exchanged(session, _off_path, "setup")


def _lines(session: Session, points: Array) -> Array:
    """(n, 3) from each reading's station to its point (n, 3), m."""
    description = session.description
    assert isinstance(description, TrackingInterferometer | RotaryAxis)
    return np.asarray(points - np.array([setup.position for setup in description.setups])[session.readings.setup])


def nominal_diagonal(session: Session, place: Place) -> Iterator[Judgement]:
    """Judgements of a step diagonal."""
    mistakes = itertools.chain(scaled(session, *UNITS, *SENSES), exchanged_axes(session, 3))
    yield _judgement(_off_diagonal, itertools.chain(mistakes, _exchanged(session, _off_diagonal, "setup")))
    yield _judgement(_off_halts, _exchanged(session, _off_halts, "setup"))


def _off_diagonal(session: Session) -> Array:
    """Displacements and positions against the runs' nominal lines."""
    description, readings = session.description, session.readings
    assert isinstance(description, StepDiagonal)
    start = np.array([setup.start for setup in description.setups])
    motion = np.array([setup.direction for setup in description.setups]) * description.step * description.blocks
    beam = motion / np.linalg.norm(motion, axis=1)[:, None]
    setup, points, group = readings.setup, readings.position(), groups(readings.setup, readings.repeat)
    path = np.sum(beam[setup] * (points - start[setup]), axis=1)
    low, high = np.minimum(start, start + motion)[setup], np.maximum(start, start + motion)[setup]
    outside = np.linalg.norm(np.clip(low - points, 0, None) + np.clip(points - high, 0, None), axis=1)
    return np.asarray(_relative(session, path, group) + outside / _extent(path, group))


def _off_halts(session: Session) -> Array:
    """Positions against those at which a diagonal halts if its moves are in the order that its id states.

    In shares of the step; each reading has the mean of its setup: the two thirds of the halts at which one order
    differs from another decide, not the middle one.
    """
    description, readings = session.description, session.readings
    assert isinstance(description, StepDiagonal)
    off, points = np.zeros(len(readings)), readings.position()
    for index in np.unique(readings.setup):
        halts, mine = _halts(description, index), readings.setup == index
        if halts is not None:
            off[mine] = np.linalg.norm(points[mine][:, None] - halts, axis=2).min(axis=1).mean()
    return off / min(description.step)


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


def nominal_rotary(session: Session, place: Place) -> Iterator[Judgement]:
    """Judgements of a rotary axis."""
    exchanges = (_exchanged(session, _off_table, kind) for kind in ("setup", "target"))
    yield _judgement(_off_table, itertools.chain(turning_mistakes(session), *exchanges))


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
    path = np.linalg.norm(_lines(session, on_table(session, readings)), axis=1)
    return _relative(session, path, groups(readings.setup, readings.repeat, readings.labels["target"]))


_SAME_ANGLE = 0.01  # rad


def nominal_probing(session: Session, place: Place) -> Iterator[Judgement]:
    """Judgements of a probing.

    Raises:
        SessionError: the column c and the setups' c are different angles.
    """
    _check_index_angles(session, place)
    other_way = turned_round(session, "the workpiece looks as if it turned the other way: check machine.rotation_sign")
    exchanges = itertools.chain(exchanged_axes(session, 2), _exchanged(session, _off_workpiece, "setup"))
    yield _judgement(_off_workpiece, itertools.chain([other_way], exchanges))
    yield _judgement(_off_workpiece, _exchanged(session, _off_workpiece, "point"), by="point")


def _off_workpiece(session: Session) -> Array:
    """Commanded positions against the nominal points of the workpiece, turned as the setups say; in its radii."""
    description, readings = session.description, session.readings
    assert isinstance(description, Probing)
    points = np.array([point.position for point in description.workpiece])
    index = places_among(readings.labels["point"], [point.id for point in description.workpiece])
    angle = session.rotation_sign * _declared(description)[readings.setup]
    off = np.linalg.norm(readings.position()[:, :2] - turned(points[index], angle), axis=1)
    return np.asarray(off / np.max(np.linalg.norm(points, axis=1), initial=0.0))


def _declared(description: Description) -> Array:
    """(setups,) angles of C, rad."""
    assert isinstance(description, Probing)
    return np.array([setup.c for setup in description.setups])


def _check_index_angles(session: Session, place: Place) -> None:
    """The column c and the setup's c must be the same angle.

    Raises:
        SessionError: the first row where they are not, with the suspicion.
    """

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
        in_degrees(session, "the column c looks", "c"),
        described(session, "the setups' c look like degrees; angles are in radians", setups=radians),
        with_columns(session, "the sign is opposite: check rotation_sign", c=-readings.columns["c"]),
    )
    what = explanation(session, [Judgement(lambda s: float(off(s).max()), suppositions, _SAME_ANGLE, _SAME_ANGLE)])
    near = np.abs(wrapped(c - declared))
    if what is None and near.min() < _SAME_ANGLE:
        what = f"this is the angle of setup {setups[int(near.argmin())].id!r}: are setups exchanged?"
    raise SessionError(
        f"{place.row(row)}: c is {c:g} rad and setup {setups[setup].id!r} stands at {declared[setup]:g} rad"
        + (f"; {what}" if what else "")
    )
