# SPDX-License-Identifier: Apache-2.0
"""Magnitudes that no machine tool has: millimetres, degrees, kelvin, hectopascals or percent by mistake."""

from collections.abc import Iterable, Iterator

import numpy as np

from machine_tool_calibration.arrays import first_true
from machine_tool_calibration.errors import SessionError, suspected
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.description import Place, StandardUncertainty, StationSetup
from machine_tool_calibration.session.session import ENOUGH_TO_DIFFER, ENVIRONMENT_COLUMNS, Session
from machine_tool_calibration.session.table import NUMERIC_COLUMNS
from machine_tool_calibration.session.values import LARGEST, SMALLEST

LARGEST_MACHINE = 50.0  # m
LARGEST_TRAVEL, LARGEST_OFFSET = 100.0, 10.0  # m
_FARTHEST_STATION, _VAGUEST_STATION = 200.0, 10.0  # m
_THOUSAND = 100.0  # a ratio beyond this is taken for 1000
FINEST, _COARSEST = 1e-11, 1e-2  # standard uncertainties of a reading, m
_MICROMETRES_FROM = 3e4  # m: a machine's travel in millimetres is not as large
MILLIMETRES = "these look like millimetres; lengths are in metres"
_LEAST_VALUE = {"air_pressure": 0.0, "relative_humidity": -0.05}  # Pa, 1
_SATURATED = 1.05  # relative humidity, with a sensor's own error
_TEMPERATURES = tuple(name for name in ENVIRONMENT_COLUMNS if name.startswith("temperature_"))
# Degrees Celsius: no workshop is as hot, and at most that in Fahrenheit.
_HOT, _HOTTEST = 48.0, 120.0
_DEGREES = "these look like degrees; angles are in radians"
_LARGEST_COVARIATE = 1e30  # the user's own column, such as nanoseconds since 1970, in any unit


def check_units(session: Session, place: Place) -> None:
    """Refuse magnitudes that can only be a wrong unit (SessionError), unless the session says `trust_units`."""
    spec_of(session).magnitudes(session, place)
    if session.description.trust_units:
        return
    with suspected():
        _travel(session, place)
        _positions(session, place)
        _instrument(session, place)
        _angles(session, place)
        _displacement(session, place)
        _environment(session, place)


def check_sizes(session: Session, place: Place) -> None:
    """Refuse (SessionError) numbers whose squares would not be numbers any more: nothing that was measured."""
    readings = session.readings
    for name, values in {**readings.columns, "displacement": readings.displacement}.items():
        size = np.abs(values)
        largest = LARGEST if name in NUMERIC_COLUMNS else _LARGEST_COVARIATE
        bad = first_true((size > largest) | ((size > 0.0) & (size < SMALLEST)))
        if bad is not None:
            what = "large" if size[bad] > 1.0 else "small"
            where = place.row(readings.row[bad])
            raise SessionError(f"{where}: {name} is {values[bad]:g}, too {what} to have been read")


def _travel(session: Session, place: Place) -> None:
    for name, (low, high) in session.description.machine.travel.items():
        reach = max(abs(low), abs(high))
        if name.lower() in "xyz" and reach > LARGEST_TRAVEL:
            raise SessionError(f"{place.description}: machine.travel.{name} reaches {reach:g} m; {MILLIMETRES}")

    offset = session.description.machine.tool_offset or (0.0, 0.0, 0.0)
    if (reach := max(map(abs, offset))) > LARGEST_OFFSET:
        raise SessionError(f"{place.description}: machine.tool_offset reaches {reach:g} m; {MILLIMETRES}")


def _positions(session: Session, place: Place) -> None:
    for axis, value, where in _largest(session, place, "xyz"):
        bounds, reach = session.description.machine.travel.get(axis), abs(value)
        travel = None if bounds is None else max(map(abs, bounds))
        if travel is not None and reach > _THOUSAND * travel:
            raise SessionError(f"{where}: {axis} is {value:g} m and the travel ends at {travel:g} m; {MILLIMETRES}")
        if reach > (LARGEST_MACHINE if travel is None else max(LARGEST_MACHINE, 2 * travel)):
            raise SessionError(f"{where}: {axis} is {value:g} m; {MILLIMETRES}")


def _instrument(session: Session, place: Place) -> None:
    description = session.description
    for index, setup in enumerate(description.setups):
        if not isinstance(setup, StationSetup):
            continue
        where, far = f"{place.description}: setups[{index}].position", max(map(abs, setup.position))
        if (known := setup.position_uncertainty or 0.0) > _VAGUEST_STATION:
            raise SessionError(f"{where}_uncertainty: station {setup.id!r} is known to {known:g} m; {MILLIMETRES}")
        if far > _FARTHEST_STATION:
            raise SessionError(f"{where}: station {setup.id!r} is {far:g} m away; {MILLIMETRES}")
    for key in ("targets", "workpiece"):
        for index, entry in enumerate(getattr(description, key, ())):
            reach = max(map(abs, entry.position))
            if reach > LARGEST_MACHINE:
                raise SessionError(f"{place.description}: {key}[{index}].position is {reach:g} m; {MILLIMETRES}")
    _declared(description.standard_uncertainty, place)


def _declared(stated: StandardUncertainty, place: Place) -> None:
    for name, one in {"": stated, **stated.setups}.items():
        key, sigma = f"setups.{name}.displacement" if name else "displacement", one.displacement
        where = f"{place.description}: standard_uncertainty.{key} is {sigma:g} m"
        if sigma > _COARSEST:
            raise SessionError(f"{where}; this looks like another unit than metres")
        if sigma < FINEST and not one.per_length:
            raise SessionError(f"{where}, less than any instrument has")


def _angles(session: Session, place: Place) -> None:
    # several turns are plausible for a rotary axis, not for a beam
    limits = {"azimuth": 2 * np.pi, "elevation": np.pi / 2, "a": 4 * np.pi, "b": 4 * np.pi, "c": 4 * np.pi}
    for name, value, where in _largest(session, place, limits):
        if abs(value) > limits[name] + 0.1:
            raise SessionError(f"{where}: {name} is {value:g} rad; {_DEGREES}")
    for index, setup in enumerate(session.description.setups):
        angle = getattr(setup, "c", 0.0)
        if abs(angle) > 4 * np.pi + 0.1:
            raise SessionError(f"{place.description}: setups[{index}].c is {angle:g} rad; {_DEGREES}")


def _displacement(session: Session, place: Place) -> None:
    values = session.readings.displacement
    if deviations := spec_of(session).reads_deviations:
        typical = float(np.median(np.abs(values[np.isfinite(values)])))
        if typical > 0.02:
            if (like := _like_places(session, typical)) is not None:
                raise SessionError(f"{place.readings}: the columns {like} and displacement look exchanged")
            raise SessionError(
                f"{place.readings}: displacement is {typical:g} m in the middle; "
                "these look like millimetres or micrometres; deviations are in metres"
            )
    known = values[np.isfinite(values)]
    if len(known) > ENOUGH_TO_DIFFER and not np.ptp(known) and not deviations:
        raise SessionError(f"{place.readings}: all {len(known)} readings are {known[0]:g} m: was the instrument read?")
    row = int(np.nanargmax(np.abs(values)))
    reach = abs(values[row])
    if reach > _FARTHEST_STATION:
        where = place.row(session.readings.row[row])
        unit = MILLIMETRES if reach < _MICROMETRES_FROM else MILLIMETRES.replace("milli", "micro")
        what = "no deviation: what was not read has no number" if deviations else unit
        raise SessionError(f"{where}: displacement is {values[row]:g} m; {what}")


def _like_places(session: Session, typical: float) -> str | None:
    """The axis whose column has deviations, where the displacements, of that size in the middle, are its places."""
    values = session.readings.displacement
    for axis in "xyz":
        position, bounds = session.readings.columns.get(axis), session.description.machine.travel.get(axis)
        if position is None or bounds is None or not np.ptp(position):
            continue
        slack = 0.05 * (bounds[1] - bounds[0])
        within = (values >= bounds[0] - slack) & (values <= bounds[1] + slack)
        if within[np.isfinite(values)].all() and np.nanmax(np.abs(position)) < 0.01 * typical:
            return axis
    return None


def _environment(session: Session, place: Place) -> None:
    columns = session.readings.columns
    known = [name for name in _TEMPERATURES if name in columns and np.isfinite(columns[name]).any()]
    # Parts may be warm; where the air is, or all of them, no workshop is.
    middle = {name: float(np.nanmedian(columns[name])) for name in known[: 1 if "temperature_air" in known else None]}
    if middle and min(middle.values()) > _HOT and max(middle.values()) < _HOTTEST:
        name = min(middle, key=lambda name: middle[name])
        raise SessionError(
            f"{place.readings}: {name} is {middle[name]:.4g} degrees Celsius in the middle; these look like degrees "
            "Fahrenheit"
        )
    for name, value, where in _largest(session, place, session.readings.columns):
        lowest = int(np.nanargmin(columns[name]))
        low, there = float(columns[name][lowest]), place.row(session.readings.row[lowest])
        if low < _LEAST_VALUE.get(name, -273.15 if name.startswith("temperature_") else -np.inf):
            raise SessionError(f"{there}: {name} is {low:g}: a value that is missing is an empty field")
        if name.startswith("temperature_") and abs(value) > 150.0:
            raise SessionError(f"{where}: {name} is {value:g} degrees Celsius; these look like kelvin")
        if name == "air_pressure" and low < 2000.0:
            unit = "hectopascals" if low > 200 else "kilopascals"
            raise SessionError(f"{there}: air_pressure is {low:g} Pa; these look like {unit}")
        if name == "relative_humidity" and abs(value) > _SATURATED:
            raise SessionError(f"{where}: relative_humidity is {value:g}; these look like percent; it is from 0 to 1")


def _largest(session: Session, place: Place, names: Iterable[str]) -> Iterator[tuple[str, float, str]]:
    """Of those of the columns that hold any value: its name, the value farthest from 0, and where it stands."""
    for name in names:
        values = session.readings.columns.get(name)
        if values is not None and np.isfinite(values).any():
            row = int(np.nanargmax(np.abs(values)))
            yield name, float(values[row]), place.row(session.readings.row[row])
