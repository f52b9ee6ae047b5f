# SPDX-License-Identifier: Apache-2.0
"""Stations that a method cannot do without: what no model of it can make anything of.

The papers ask for 3 stations in the plane and 4 in space (Ibaraki et al. 2014, Section 2; Zhang et al. 2015, Section
2). With fewer, a machine of rigid bodies can still be identified, and three stations see all of a rotary axis with
three targets. What a session leaves undetermined is the estimator's to find and name.
"""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.description import Place, StationSetup
from machine_tool_calibration.session.session import Session

__all__ = ["counted", "enough_stations", "on_a_line", "refuse_one_line"]

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
    session: Session,
    setups: tuple[StationSetup, ...],
    measured: BoolArray,
    place: Place,
    *,
    needed: int,
    method: str,
) -> None:
    """Refuse stations at one place, and too few of them that were read.

    Args:
        session: the measurement.
        setups: its stations.
        measured: (n,) which of its readings are there.
        place: names for messages.
        needed: how many stations there must be at least.
        method: that needs them, in words.

    Raises:
        SessionError: which stations, or how many there are.
    """
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
            f"{place.description if not silent else place.readings}: {counted(len(used), 'station')}; "
            f"{method} needs at least {needed}{without}"
        )


def refuse_one_line(setups: tuple[StationSetup, ...], place: Place) -> None:
    """Raise a SessionError where all of three stations or more stand on one line."""
    if len(setups) > 2 and on_a_line(np.array([setup.position for setup in setups])):
        raise SessionError(
            f"{place.description}: all stations stand on one line: no reading shows a turn about it; move one of them "
            "off the line"
        )


def counted(number: int, thing: str) -> str:
    """`1 station`, `2 stations`."""
    return f"{number} {thing}" + ("" if number == 1 else "s")
