# SPDX-License-Identifier: Apache-2.0
"""Circles with a double ball bar in the planes of two linear axes (ISO 230-4): traits and checks."""

from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from machine_tool_calibration.arrays import first_true
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.methods.ball_bar.circle import angles, arms, in_plane, travel_sense, way_over_time
from machine_tool_calibration.session.description import BallBar, Place
from machine_tool_calibration.session.judgements import Held
from machine_tool_calibration.session.method import MethodSpec
from machine_tool_calibration.session.session import Session

# Share of the radius by which a commanded place may be off its circle, and largest deviation that a bar reads, m.
_OFF_CIRCLE, _RANGE = 1e-3, 3e-3
# Times by which a stated feed may be off that of way and time, which accelerates and is rounded.
_FEED = 2.0
# Least arc of a circular test, rad: where the machine leaves no room for a circle, 220° are usual.
_LEAST_ARC = 3.5


class CircleSpec(MethodSpec):
    """A centre, a length, a squareness and a difference of scales need at least eight readings on an arc."""

    description = BallBar
    needed = 8
    remounted = "the ball bar"
    model = "machine_tool_calibration.methods.ball_bar.model"
    models: ClassVar = {
        "circle": "the only one: centre and length of the bar in every setup; squareness and difference of the scales"
    }
    reads_deviations = reads_machine = centred = True
    by_axes = ("circle",)
    steps = "machine_tool_calibration.methods.ball_bar.steps:circle_steps"
    planned = "machine_tool_calibration.methods.ball_bar.steps:nominal"
    pictures = "machine_tool_calibration.plots.ball_bar"

    def columns(self, description: BallBar) -> tuple[str, ...]:
        """Places in the planes of the circles."""
        letters = sorted({axis.lower() for setup in description.setups for axis in setup.plane})
        return ("setup", *letters, "displacement")

    def words(self, description: BallBar) -> str:
        """What it is."""
        planes = ", ".join(dict.fromkeys(setup.plane for setup in description.setups))
        return f"circles with a ball bar in {planes} (ISO 230-4)"

    def magnitudes(self, session: Session, place: Place) -> None:
        """Refuse readings that are the bar's length rather than its deviation, or in another unit."""
        read = session.readings.displacement
        bad = first_true(np.abs(read) > _RANGE)
        if bad is None:
            return
        where, value = place.row(session.readings.row[bad]), float(read[bad])
        radius = session.description.as_a(BallBar).setups[session.readings.setup[bad]].radius
        what = f"displacement is {value:g} m, more than a ball bar's range of {_RANGE * 1e3:g} mm"
        if abs(value - radius) < _RANGE:
            what += "; it looks like the length: a deviation is the length less the radius"
        elif abs(value) * 1e-3 < _RANGE:
            what += "; it looks like millimetres"
        elif abs(value) * 1e-6 < _RANGE:
            what += "; it looks like micrometres"
        raise SessionError(f"{where}: {what}")

    def held(self, session: Session) -> Iterator[Held]:
        """Commanded places against the circle, and directions of approach against the way round it."""
        description, readings = session.description.as_a(BallBar), session.readings
        radius = np.array([setup.radius for setup in description.setups])[readings.setup]
        arm, plane = arms(description, readings)
        length = np.linalg.norm(in_plane(arm, plane), axis=1)
        yield Held("place", "the stated circle", np.abs(length - radius), _OFF_CIRCLE * radius)
        sense = travel_sense(arm, plane, readings)
        if sense is not None:
            off = np.where(np.isnan(sense), 1.0, 0.0)
            yield Held("dir", "one way round the circle", off, np.full(len(off), 0.5), unit="", share=0.05)

    def suspicious(self, session: Session) -> Iterator[str]:
        """Arcs, circles without directions of approach, and a feed that is not that of way and time."""
        description = session.description.as_a(BallBar)
        setups = description.setups
        angle = angles(*arms(description, session.readings))
        known = np.isfinite(angle)
        for k in np.unique(session.readings.setup[known]):
            ordered = np.sort(np.mod(angle[known & (session.readings.setup == k)], 2.0 * np.pi))
            read = 2.0 * np.pi - float(np.diff(ordered, append=ordered[0] + 2.0 * np.pi).max())
            if read < _LEAST_ARC:
                arc = f"{np.degrees(read):.0f}° of its circle"
                yield f"setup {setups[k].id!r} was read over {arc}: G and the centre are of that arc alone"
        stated = np.array([setup.feed or np.nan for setup in setups])[session.readings.setup]
        ratio = stated / way_over_time(session.readings)
        for k in np.unique(session.readings.setup[(ratio > _FEED) | (ratio * _FEED < 1.0)]):
            made = float(np.nanmedian((stated / ratio)[session.readings.setup == k]))
            yield f"setup {setups[k].id!r} states a feed of {setups[k].feed:g} m/s, and way over time is {made:.3g} m/s"
        if not any(name.startswith("dir_") for name in session.readings.columns):
            yield "no directions of approach (dir_x, …) were recorded: backlash and servo mismatch stay unseen"


SPEC = CircleSpec()
