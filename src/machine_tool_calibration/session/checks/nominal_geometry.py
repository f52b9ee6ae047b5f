# SPDX-License-Identifier: Apache-2.0
"""Readings against the nominal geometry of their method, only as good as needed to see a mistake, and enough stations.

The nominal geometry predicts every reading to about the uncertainty of the stations. How far a reading is off is told
in shares of what is predicted, so that it does not depend on the unit.

The papers ask for 3 stations in the plane and 4 in space (Ibaraki et al. 2014, Section 2; Zhang et al. 2015, Section
2). With fewer, a machine of rigid bodies can still be identified, and three stations see all of a rotary axis with
three targets. What a session leaves undetermined is the estimator's to find and name.
"""

from collections.abc import Callable, Iterable, Iterator

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, group_ranges, groups
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.checks.mistakes import exchanged
from machine_tool_calibration.session.description import Place, Probing, StationSetup
from machine_tool_calibration.session.judgements import Judgement, Supposition
from machine_tool_calibration.session.session import Session, places_among


def nominal_points(description: Probing) -> tuple[Array, Array]:
    """(N, 2) points of the workpiece in its frame, m, and (N, 2) their outward unit normals."""
    position = np.array([point.position for point in description.workpiece])
    normal = np.array([point.normal for point in description.workpiece])
    return position, normal / np.linalg.norm(normal, axis=1)[:, None]


def turned(points: Array, angle: Array) -> Array:
    """(n, 2) points turned counter-clockwise by angle (n,), rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.column_stack([cos * points[:, 0] - sin * points[:, 1], sin * points[:, 0] + cos * points[:, 1]])


def wrapped(angle: Array) -> Array:
    """The angle to the nearest turn, rad."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


_FITS = 0.1  # of what is predicted
_MISFIT_LEFT = 0.2  # of the misfit as it is

Off = Callable[[Session], Array]
"""Of a session, (n,) how far each reading is off, in shares of what is predicted."""


def judged_by_worst(off: Off, suppositions: Iterable[Supposition], by: str = "setup") -> Judgement:
    """By the setup or point whose readings are the furthest off."""

    def misfit(session: Session) -> float:
        return float(np.nanmax(_by_group(session, off, by)[1], initial=0.0))

    return Judgement(misfit, suppositions, absurd=_FITS, good=_FITS, better=_MISFIT_LEFT)


def badly_exchanged(session: Session, off: Off, kind: str) -> Iterator[Supposition]:
    """Exchanges of two setups, targets or points that do not fit as they are."""
    ids, misfit = _by_group(session, off, kind)
    yield from exchanged(session, kind, [name for name, one in zip(ids, misfit, strict=True) if one > _FITS])


def _by_group(session: Session, off: Off, kind: str) -> tuple[list[str], Array]:
    """Ids of the setups, targets or points, and for each how far its readings are off in the middle; NaN for none."""
    readings, key = session.readings, {"target": "targets", "point": "workpiece"}.get(kind, "setups")
    ids = [entry.id for entry in getattr(session.description, key)]
    which = readings.setup if kind == "setup" else places_among(readings.labels[kind], ids)
    return ids, group_ranges(off(session), which, len(ids))[1]


def relative_misfit(session: Session, predicted: Array, group: IntArray) -> Array:
    """(n,) how far displacements are off a prediction (n,), m, by group, as a share of half its range in a group."""
    return off_prediction(session, predicted, group) / typical_extent(predicted, group)


def off_prediction(session: Session, predicted: Array, group: IntArray) -> Array:
    """(n,) how far displacements are off a prediction (n,), each group (n,) having a zero of its own, m."""
    difference = session.readings.displacement - predicted
    zero = group_ranges(difference, group, int(group.max(initial=-1)) + 1)[1]
    return np.asarray(np.abs(difference - zero[group]))


def typical_extent(predicted: Array, group: IntArray) -> float:
    """Half the range of a prediction (n,) in a group (n,), in the middle of all groups."""
    low, _, high = group_ranges(predicted, group, int(group.max(initial=-1)) + 1)
    known = np.isfinite(low)
    return float(np.median((high - low)[known])) / 2 if known.any() else np.nan


def lines_of_sight(session: Session, points: Array) -> Array:
    """(n, 3) from each reading's station to its point (n, 3), m; of a method with stations."""
    stations = np.array([getattr(setup, "position") for setup in session.description.setups])  # noqa: B009
    return np.asarray(points - stations[session.readings.setup])


_SAME_PLACE = 1e-6  # m: below any remounting, so a copied entry
_LINE = 1e-3  # second extent over the first


def on_a_line(points: Array) -> bool:
    """Whether all points (n, d) lie on one line (or at one place), to a thousandth of their extent."""
    if len(points) < 3:
        return True
    # extents come from the small moment matrix: its square root resolves 1e-8, far below the threshold
    centred = points - points.mean(axis=0)
    extents = np.sqrt(np.clip(np.linalg.eigvalsh(centred.T @ centred), 0.0, None))
    return bool(extents[-2] <= _LINE * extents[-1])


def enough_stations(
    session: Session, setups: tuple[StationSetup, ...], measured: BoolArray, place: Place, *, needed: int, method: str
) -> None:
    """Refuse stations at one place, fewer than the method (in words) needs that were read, or in space all on a line.

    By a SessionError. One that was moved a little on its way stands at its place twice, and counts as one: what it had
    read it did not read again.
    """
    positions, readings = np.array([setup.position for setup in setups]), session.readings
    asked, station = groups(readings.alike(setup=False), readings.repeat), np.arange(len(setups))
    for second in range(1, len(setups)):
        distance = np.linalg.norm(positions[:second] - positions[second], axis=1)
        first = int(np.argmin(distance))
        if distance[first] > _SAME_PLACE:
            continue
        if len(np.intersect1d(*(asked[measured & (readings.setup == k)] for k in (first, second)))):
            raise SessionError(
                f"{place.description}: setups[{second}].position: station {setups[second].id!r} "
                f"stands at the place of station {setups[first].id!r}"
            )
        station[second] = station[first]
    used = np.unique(readings.setup[measured])
    count = len(np.unique(station[used]))
    if count < needed:
        silent = [setup.id for index, setup in enumerate(setups) if index not in used]
        without = f" (no reading from {', '.join(silent[:8])})" if silent else ""
        raise SessionError(
            f"{place.description if not silent else place.readings}: {counted(count, 'station')}; "
            f"{method} needs at least {needed}{without}"
        )
    if session.description.axes == "xyz" and len(setups) > 2 and on_a_line(positions):
        raise SessionError(
            f"{place.description}: all stations stand on one line: no reading shows a turn about it; move one of them "
            "off the line"
        )


def counted(number: int, thing: str) -> str:
    """`1 station`, `2 stations`."""
    return f"{number} {thing}" + ("" if number == 1 else "s")
