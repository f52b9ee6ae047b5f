# SPDX-License-Identifier: Apache-2.0
"""The tracking interferometer: its traits, and readings against the stations as they are stated."""

from collections.abc import Iterator
from functools import partial
from typing import ClassVar

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, first_true, groups, unit_vectors
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.checks import mistakes
from machine_tool_calibration.session.checks.nominal_geometry import (
    badly_exchanged,
    enough_stations,
    judged_by_worst,
    lines_of_sight,
    off_prediction,
    on_a_line,
    relative_misfit,
    wrapped,
)
from machine_tool_calibration.session.checks.places import allowed
from machine_tool_calibration.session.description import Place, TrackingInterferometer
from machine_tool_calibration.session.judgements import GROSS, Held, Judgement, Supposition
from machine_tool_calibration.session.method import MethodSpec
from machine_tool_calibration.session.session import Session, distinct_places
from machine_tool_calibration.words import say

# By how much the beam's axis may miss the retroreflector's centre, and a path be off, beside the station's place, m.
_MISSED, _ERROR = 0.02, 0.01
# By how much readings of one station, in one repeat, at one place may differ, m: no machine reproduces so badly.
_AGAIN = 0.001
# Share of a station's beams that may point elsewhere: they are commanded, but single ones are set aside like a reading.
_SINGLE = 0.03
# Share of an azimuth's error within which it is the same at all readings.
_SAME_ERROR = 0.1
# Zero of all azimuths beyond which the turn of the network is no longer small: its square is a micrometre on a metre.
_ZERO = 1.5e-3
_LEAST_REACH = 1e-4  # m, from a station to a target


class TrackingSpec(MethodSpec):
    """A tracking interferometer."""

    description = TrackingInterferometer
    model = "machine_tool_calibration.methods.tracking.model"
    models: ClassVar = {
        "free": "the default: every target has a position of its own, whatever moves the tool; each needs one "
        "station more than there are dimensions",
        "rigid_body": "the axes are rigid bodies, their errors tables over their positions: few stations do, other "
        "sessions can share the tables, and places between the targets are told",
    }
    turned_part = ("the retroreflector", ("retroreflector_form",))
    free_order = True
    tables = "rigid_body"
    by_axes = ("rigid_body",)
    no_tables = "the model 'free' has none; identify with --model rigid_body"
    steps = "machine_tool_calibration.procedure.steps:path_steps"
    further_places = "machine_tool_calibration.planning.places:further_stations"
    planned = "machine_tool_calibration.planning.forecast:from_stations"
    pictures = "machine_tool_calibration.plots.tracking"

    def columns(self, description: TrackingInterferometer) -> tuple[str, ...]:
        """The commanded direction of the beam, where it does not follow the target."""
        angles = ("azimuth", "elevation")[: description.dimension - 1] if description.pointing == "open_loop" else ()
        return ("setup", "repeat", *description.axes, *angles, "displacement")

    def words(self, description: TrackingInterferometer) -> str:
        """How the beam points, in how many dimensions."""
        pointing = "following the target" if description.pointing == "tracking" else "pointed open loop"
        return f"tracking interferometer in {description.dimension} dimensions, {pointing}"

    def enough(self, session: Session, measured: BoolArray, place: Place) -> None:
        """Stations and targets.

        A SessionError: two stations at one place, too few stations, targets or readings, all targets on a line.
        """
        description = session.description.as_a(TrackingInterferometer)
        method = f"tracking_interferometer in {description.dimension} dimensions"
        enough_stations(session, description.setups, measured, place, needed=2, method=method)
        reach = np.linalg.norm(lines_of_sight(session, session.readings.position())[:, : description.dimension], axis=1)
        if (at := first_true(measured & (reach < _LEAST_REACH))) is not None:
            name = session.setup_ids[session.readings.setup[at]]
            raise SessionError(f"{place.row(at)}: the target is where setup {name!r} stands: no beam leads there")
        _enough_targets(session, description.dimension, measured, place, method)

    def nominal(self, session: Session, place: Place) -> Iterator[Judgement]:
        """Judgements of a tracking interferometer."""
        description = session.description.as_a(TrackingInterferometer)
        if description.pointing == "open_loop":
            yield judged_by_worst(_off_beam, _beam_mistakes(session, description.dimension))
        yield judged_by_worst(_off_path, _path_mistakes(session, description))

    def held(self, session: Session) -> Iterator[Held]:
        """Commanded beams and displacements against the stations as they are stated."""
        description, readings = session.description.as_a(TrackingInterferometer), session.readings
        reach = np.linalg.norm(lines_of_sight(session, readings.position())[:, : description.dimension], axis=1)
        place = np.array([allowed(session, setup.position_uncertainty) for setup in description.setups])[readings.setup]
        if description.pointing == "open_loop":
            beam = "the beam (azimuth)" if description.dimension == 2 else "the beam (azimuth, elevation)"
            against = "the direction from the stated place of the station to the target"
            within, hint = (place + _MISSED) / np.maximum(reach, 1e-9), partial(_zero_angle, session)
            yield Held(beam, against, _off_beam(session), within, "rad", share=_SINGLE, hint=hint)
        against = "the change of distance from the stated place of the station to the target"
        yield Held("displacement", against, off_prediction(session, reach, readings.setup), 2.0 * place + _ERROR)

    def suspicious(self, session: Session) -> Iterator[str]:
        """Readings at one place that differ, and an azimuth that all stations count from another zero.

        Of the latter the map's turn would take up only the first order.
        """
        description = session.description.as_a(TrackingInterferometer)
        off = _off_again(session)
        if (count := int((off > _AGAIN).sum())) > GROSS * len(off):
            yield say("suspicion.again", n=count, count=len(off), off=f"{1e3 * off.max():.3g}")
        used = np.unique(session.readings.setup)
        if description.pointing != "open_loop" or len(used) < 2:
            return
        zeros = np.array([np.median(_azimuth_off(session, setup)) for setup in used])
        middle = float(np.median(zeros))
        if abs(middle) > _ZERO and np.abs(zeros - middle).max() < _SAME_ERROR * abs(middle):
            yield say("suspicion.azimuth", off=f"{1e3 * middle:.3g}")


SPEC = TrackingSpec()


def _enough_targets(session: Session, dimension: int, measured: BoolArray, place: Place, method: str) -> None:
    positions = session.readings.position()[measured][:, :dimension]
    first, index = distinct_places(positions)
    points = positions[first]
    if len(points) < 3 or (dimension == 3 and on_a_line(points)):
        what = "there are fewer than three targets" if len(points) < 3 else "all targets lie on a line"
        raise SessionError(f"{place.readings}: {what}; {method} needs targets spread over a plane")
    stations = session.readings.setup[measured]
    pairs = np.flatnonzero(np.bincount(index * len(session.setup_ids) + stations))
    seen_by = np.bincount(pairs // len(session.setup_ids))
    redundant = np.clip(seen_by - dimension, 0, None).sum()
    count = len(np.unique(stations))
    unknown = (dimension + 1) * count - (3 if dimension == 2 else 6)
    # Rigid bodies have three or six error motions at every position of every axis, however many targets there are.
    at_axes = sum(len(distinct_places(points[:, j : j + 1])[0]) for j in range(dimension))
    rigid = (dimension + 1) * count + (3 if dimension == 2 else 6) * at_axes
    if redundant < unknown and len(pairs) < rigid:
        # A target that is read as often as it has coordinates is no condition, however many there are.
        lack = "more targets from all stations" if seen_by.max() > dimension else f"from {dimension + 1} stations"
        raise SessionError(
            f"{place.readings}: too few readings: {len(points)} targets and {count} stations leave {redundant} "
            f"conditions for the {unknown} unknowns of the stations; measure {lack}"
        )


def _off_beam(session: Session) -> Array:
    description, readings = session.description.as_a(TrackingInterferometer), session.readings
    upright = 0.0 if description.dimension == 2 else 1.0
    elevation = upright * readings.columns.get("elevation", np.zeros(len(readings)))
    beam = unit_vectors(readings.columns["azimuth"], elevation)
    line = lines_of_sight(session, readings.position()) * (1.0, 1.0, upright)
    cosine = np.sum(beam * line, axis=1) / np.linalg.norm(line, axis=1)
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)))


def _beam_mistakes(session: Session, dimension: int) -> Iterator[Supposition]:
    azimuth = session.readings.columns["azimuth"]
    elevation = session.readings.columns.get("elevation", np.zeros(len(azimuth)))
    yield mistakes.in_degrees(session, "azimuth and elevation look", "azimuth", "elevation")
    what = "azimuth and elevation point from the target to the station"
    yield mistakes.with_columns(session, what, azimuth=azimuth + np.pi, elevation=-elevation)
    what = "azimuth looks as if it was counted clockwise; it is counter-clockwise from +X, seen from +Z"
    yield mistakes.with_columns(session, what, azimuth=-azimuth)
    yield mistakes.with_columns(session, "azimuth looks as if it was off by half a turn", azimuth=azimuth + np.pi)
    yield from mistakes.exchanged_axes(session, dimension)
    yield from badly_exchanged(session, _off_beam, "setup")


def _off_path(session: Session) -> Array:
    dimension = session.description.as_a(TrackingInterferometer).dimension
    line = lines_of_sight(session, session.readings.position())[:, :dimension]
    return relative_misfit(session, np.linalg.norm(line, axis=1), session.readings.setup)


def _path_mistakes(session: Session, description: TrackingInterferometer) -> Iterator[Supposition]:
    yield from mistakes.scaled(session, *mistakes.UNITS, *mistakes.SENSES)
    places = ((setup, tuple(1e-3 * v for v in setup.position)) for setup in description.setups)
    setups = tuple(setup.model_copy(update={"position": place}) for setup, place in places)
    yield mistakes.described(session, f"the stations' positions look {mistakes.LENGTHS}", setups=setups)
    metres = dict(zip("xyz", 1e-3 * session.readings.position().T, strict=True))
    yield mistakes.with_columns(session, f"x, y and z look {mistakes.LENGTHS}", **metres)
    yield from mistakes.exchanged_axes(session, description.dimension)
    yield from badly_exchanged(session, _off_path, "setup")


def _off_again(session: Session) -> Array:
    """(k,) displacements off the middle one that the same station read in the same repeat at the same place, m."""
    readings = session.readings.select(np.isfinite(session.readings.displacement))
    place = distinct_places(readings.position())[1]
    group = groups(readings.setup, readings.repeat, place)
    order = np.lexsort((readings.displacement, group))
    first, count = np.unique(group[order], return_index=True, return_counts=True)[1:]
    return np.asarray(np.abs(readings.displacement - readings.displacement[order][first + count // 2][group]))


def _azimuth_off(session: Session, setup: int) -> Array:
    """Azimuths of a station against the directions to the targets, rad."""
    mine = session.readings.setup == setup
    line = lines_of_sight(session, session.readings.position())[mine]
    return wrapped(session.readings.columns["azimuth"][mine] - np.arctan2(line[:, 1], line[:, 0]))


def _zero_angle(session: Session, setup: int) -> str:
    """Whether a pointer counts its azimuth from another zero."""
    off = _azimuth_off(session, setup)
    middle = float(np.median(off))
    if np.median(np.abs(off - middle)) > _SAME_ERROR * abs(middle):
        return ""
    return f"azimuth is {middle:.3g} rad too large throughout: is it counted from +X?"
