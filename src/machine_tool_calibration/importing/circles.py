# SPDX-License-Identifier: Apache-2.0
"""Circles of a ball bar: radius or its deviation over the angle, round one way and the other, as readings."""

import numpy as np
from scipy.ndimage import median_filter

from machine_tool_calibration.arrays import Array, IntArray, first_true
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.importing.columns import Columns, Rows
from machine_tool_calibration.methods.ball_bar.circle import places
from machine_tool_calibration.session.defects import validated
from machine_tool_calibration.session.description import CircleSetup

_CCW = ("ccw", "+", "+1", "1", "g3", "g03", "left", "↺")
_CW = ("cw", "-", "-1", "g2", "g02", "right", "↻")
# Steps of which most go the way round: a trigger scatters. Readings that a run has at least. Share of the usual step
# below which nothing moved.
_WINDOW, _FEWEST, _STANDS = 5, 8, 0.25


def circle_rows(columns: Columns, name: str) -> Rows:
    """A reading for each angle, at the place on the circle that the setup states; `name` is the setup's id.

    Runs are told apart by the way round: that of a column `way`, or of the angles' own order.
    """
    columns.need(("angle",), "where on the circle")
    setup = _setup(columns, name)
    angle = columns.filled("angle", columns.number("angle"))
    if columns.has("radius"):
        deviation = columns.number("radius") - setup.radius
    else:
        columns.need(("deviation",), "or radius: what was read")
        deviation = columns.number("deviation")
    if columns.mapping.sign == "nominal-minus-actual" and not columns.has("radius"):
        deviation = -deviation
    sense, run = _runs(columns, angle)
    place, tangent = places(setup, angle)
    numbers: dict[str, Array] = dict(zip("xyz", place.T, strict=True))
    for axis in setup.plane:
        numbers[f"dir_{axis.lower()}"] = np.where(sense * tangent[:, "XYZ".index(axis)] < 0.0, -1.0, 1.0)
    # The first run counter-clockwise and the first clockwise are the first repeat.
    number = np.zeros(len(angle))
    for way in (-1.0, 1.0):
        mine = sense == way
        number[mine] = np.unique(run[mine], return_inverse=True)[1]
    numbers |= {"repeat": number, "displacement": deviation}
    numbers |= columns.others(("angle", "radius", "deviation", "way", "repeat", *numbers))
    stated = setup.model_dump(exclude_none=True, mode="json")
    described = {"method": "ball_bar", "setups": [stated], "repeats": int(number.max(initial=0.0)) + 1}
    return Rows(numbers, {"setup": np.full(len(angle), setup.id)}, np.arange(len(angle)), described)


def _setup(columns: Columns, name: str) -> CircleSetup:
    """The circle of the table: the only one that is described, or that of several whose id is the table's name."""
    setups = columns.mapping.session.get("setups")
    entries = [one for one in setups if isinstance(one, dict)] if isinstance(setups, list) else []
    mine = entries if len(entries) == 1 else [one for one in entries if str(one.get("id")) == name]
    if len(mine) != 1:
        raise SessionError(
            f"{columns.table.source}: session.setups must say which circle {name!r} is, as in "
            "- {id: XY, plane: XY, centre: [0.25, 0.2, 0.1], radius: 0.15}"
        )
    return validated(CircleSetup, {"id": name, **mine[0]}, f"{columns.table.source}: session.setups")


def _runs(columns: Columns, angle: Array) -> tuple[Array, IntArray]:
    """(n,) sense of each reading, and (n,) number of its run: one way round without a break."""
    if columns.has("way"):
        words = np.char.lower(columns.text("way"))
        forth, back = np.isin(words, _CCW), np.isin(words, _CW)
        bad = first_true(~(forth | back))
        if bad is not None:
            raise SessionError(f"{columns.table.where(bad)}: way is {str(words[bad])!r}, neither ccw nor cw")
        sense = np.where(forth, 1.0, -1.0)
        return sense, np.cumsum(np.diff(sense, prepend=sense[:1]) != 0.0)
    step = np.angle(np.exp(1j * np.diff(angle, prepend=2.0 * angle[:1] - angle[1:2])))
    # Where a run begins at the place at which the last one ended, the next step says which way it goes.
    moves = np.abs(step) > _STANDS * np.median(np.abs(step))
    after = np.minimum.accumulate(np.where(moves, np.arange(len(step)), len(step) - 1)[::-1])[::-1]
    sense = median_filter(np.sign(step[after]), _WINDOW, mode="nearest")
    run = np.cumsum(np.diff(sense, prepend=sense[:1]) != 0.0)
    if (sense == 0.0).any() or np.bincount(run).min() < _FEWEST:
        raise SessionError(
            f"{columns.table.source}: the angles go neither one way round nor first one and then the other; a column "
            "way (ccw, cw) says which readings belong together"
        )
    return sense, run
