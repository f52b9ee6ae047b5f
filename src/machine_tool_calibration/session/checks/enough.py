# SPDX-License-Identifier: Apache-2.0
"""Stations, targets and readings that a method cannot do without: what no model of it can make anything of.

The papers ask for 3 stations in the plane and 4 in space (Ibaraki et al. 2014, Section 2; Zhang et al. 2015, Section
2). With fewer, a machine of rigid bodies can still be identified, and three stations see all of a rotary axis with
three targets. What a session leaves undetermined is the estimator's to find and name.
"""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, groups
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.description import (
    Place,
    RotaryAxis,
    StationSetup,
    TrackingInterferometer,
    rotary_column,
)
from machine_tool_calibration.session.session import Session, distinct_places

__all__ = [
    "enough_in_a_setup",
    "enough_probing",
    "enough_rotary",
    "enough_tracking",
    "on_a_line",
]

_SAME_PLACE = 1e-6  # m: below any remounting, so a copied entry
_LINE = 1e-3  # second extent over the first
# Nodes of the tables of a probing from which more unknowns than touches (two position errors a node) take minutes.
_MANY_NODES, _AT_A_NODE = 100, 2


def enough_tracking(session: Session, measured: BoolArray, place: Place) -> None:
    """Stations and targets of a tracking interferometer.

    Raises:
        SessionError: two stations at one place, too few stations, targets or readings, all targets on a line.
    """
    description = session.description
    assert isinstance(description, TrackingInterferometer)
    _stations(session, description.setups, 2, measured, place)
    if description.dimension == 3:
        _off_a_line(description.setups, place)
    _tracking(session, description.dimension, measured, place)


def enough_rotary(session: Session, measured: BoolArray, place: Place) -> None:
    """Stations, targets and angles of a rotary axis; errors as for `enough_tracking`."""
    description = session.description
    assert isinstance(description, RotaryAxis)
    _stations(session, description.setups, 3, measured, place)
    _off_a_line(description.setups, place)
    _rotary(session, description, measured, place)


def on_a_line(points: Array) -> bool:
    """Whether all points (n, d) lie on one line (or at one place), to a thousandth of their extent."""
    if len(points) < 3:
        return True
    # extents come from the small moment matrix: its square root resolves 1e-8, far below the threshold
    centred = points - points.mean(axis=0)
    extents = np.sqrt(np.clip(np.linalg.eigvalsh(centred.T @ centred), 0.0, None))
    return bool(extents[-2] <= _LINE * extents[-1])


def _stations(
    session: Session, setups: tuple[StationSetup, ...], needed: int, measured: BoolArray, place: Place
) -> None:
    positions = np.array([setup.position for setup in setups])
    for second in range(1, len(setups)):
        distance = np.linalg.norm(positions[:second] - positions[second], axis=1)
        first = int(np.argmin(distance))
        if distance[first] <= _SAME_PLACE:
            raise SessionError(
                f"{place.description}: setups[{second}].position: station {setups[second].id!r} "
                f"stands at the place of station {setups[first].id!r}"
            )
    used = np.unique(session.readings.setup[measured])
    if len(used) < needed:
        silent = [setup.id for index, setup in enumerate(setups) if index not in used]
        without = f" (no reading from {', '.join(silent[:8])})" if silent else ""
        raise SessionError(
            f"{place.description if not silent else place.readings}: {_count(len(used), 'station')}; "
            f"{_method(session)} needs at least {needed}{without}"
        )


def _off_a_line(setups: tuple[StationSetup, ...], place: Place) -> None:
    if len(setups) > 2 and on_a_line(np.array([setup.position for setup in setups])):
        raise SessionError(
            f"{place.description}: all stations stand on one line: no reading shows a turn about it; move one of them "
            "off the line"
        )


def _tracking(session: Session, dimension: int, measured: BoolArray, place: Place) -> None:
    positions = session.readings.position()[measured][:, :dimension]
    first, index = distinct_places(positions)
    points = positions[first]
    if len(points) < 3 or (dimension == 3 and on_a_line(points)):
        what = "there are fewer than three targets" if len(points) < 3 else "all targets lie on a line"
        raise SessionError(f"{place.readings}: {what}; {_method(session)} needs targets spread over a plane")
    stations = session.readings.setup[measured]
    pairs = np.flatnonzero(np.bincount(index * len(session.setup_ids) + stations))
    redundant = np.clip(np.bincount(pairs // len(session.setup_ids)) - dimension, 0, None).sum()
    count = len(np.unique(stations))
    unknown = (dimension + 1) * count - (3 if dimension == 2 else 6)
    # Rigid bodies have three or six error motions at every position of every axis, however many targets there are.
    rigid = (dimension + 1) * count + _unknown_of_axes(points)
    if redundant < unknown and len(pairs) < rigid:
        raise SessionError(
            f"{place.readings}: too few readings: {len(points)} targets and {count} stations leave {redundant} "
            f"conditions for the {unknown} unknowns of the stations; measure more targets from all stations"
        )


def _unknown_of_axes(points: Array) -> int:
    """Values of the linear axes' error motions at the positions of targets (n, d)."""
    positions = sum(len(distinct_places(points[:, j : j + 1])[0]) for j in range(points.shape[1]))
    return (3 if points.shape[1] == 2 else 6) * positions


def _rotary(session: Session, description: RotaryAxis, measured: BoolArray, place: Place) -> None:
    readings = session.readings
    ids = [target.id for target in description.targets]
    used = [i for i, name in enumerate(ids) if np.any(readings.labels["target"][measured] == name)]
    straight = on_a_line(np.array([description.targets[i].position for i in used]))
    angle = readings.columns[rotary_column(description)][measured]
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
        raise SessionError(
            f"{place.readings}: too few readings: {different} different ones at {angles} angles "
            f"for {unknown} unknowns; measure more angles"
        )


def enough_probing(session: Session, measured: BoolArray, place: Place) -> None:
    """Angles of C and touches of a probing; errors as for `enough_in_a_setup`."""
    used = np.unique(session.readings.setup[measured])
    if len(used) < 2:
        raise SessionError(
            f"{place.readings}: touches at {_count(len(used), 'C angle')}; probing needs at least 2 "
            "to distinguish the workpiece from the machine"
        )
    grid = session.description.machine.table_grid or {}
    nodes = sum(len(places) for axis, places in grid.items() if axis.lower() in "xy")
    touches = int(np.count_nonzero(measured))
    if nodes > _MANY_NODES and _AT_A_NODE * nodes > touches:
        raise SessionError(
            f"{place.description}: table_grid has {nodes} nodes, which are {_AT_A_NODE * nodes} unknown errors of the "
            f"axes at least, and there are {touches} touches: give fewer nodes, or leave it out"
        )
    enough_in_a_setup(session, measured, place)


def enough_in_a_setup(session: Session, measured: BoolArray, place: Place, needed: int = 1) -> None:
    """Some setup must have readings enough; what was lost in others is named by the estimator.

    Raises:
        SessionError: fewer than two readings, or no setup has as many as needed.
    """
    good = np.bincount(session.readings.setup[measured], minlength=len(session.setup_ids))
    if good.sum() < 2:
        raise SessionError(f"{place.readings}: too few readings: {good.sum()}, and at least 2 are needed")
    if good.max() < needed:
        raise SessionError(
            f"{place.readings}: too few readings: no setup has more than {good.max()}; at least {needed} are needed"
        )


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" + ("" if number == 1 else "s")


def _method(session: Session) -> str:
    if isinstance(session.description, TrackingInterferometer):
        return f"tracking_interferometer in {session.description.dimension} dimensions"
    return session.method
