# SPDX-License-Identifier: Apache-2.0
"""Where stations and targets stand if the table turned without error: the point from which the fit sets out.

Sessions that contradict their own geometry there are refused, with the common mistake that explains it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import blake2b

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from machine_tool_calibration.arrays import NORMAL_MEDIAN, Array, IntArray, best_motion, group_ranges
from machine_tool_calibration.errors import ModelError, SessionError, suspected
from machine_tool_calibration.methods.rotary_axis.geometry import TableReadings, table_readings
from machine_tool_calibration.methods.rotary_axis.spec import turning_mistakes
from machine_tool_calibration.session.checks.mistakes import exchanged, explanation, refuse_contradictions, shifted
from machine_tool_calibration.session.checks.nominal_geometry import off_prediction
from machine_tool_calibration.session.description import Place, RotaryAxis, StationSetup, Target
from machine_tool_calibration.session.judgements import Held, Judgement, Supposition
from machine_tool_calibration.session.session import Session

# Errors of a rotary axis are some micrometres; a nominal position may be wrong by centimetres. Both only shape the way
# to the start: the fit that follows holds no such knowledge.
_ERRORS = 1e-5
_NOMINAL = 0.05
# Misfit at which other places to set out from are tried, m, and how many.
_ABSURD = 3e-5
_TRIES = 8
# The same for places beside the stated ones; how far beside, at most, m; and how far the fit may then go.
_DOUBTFUL = 1e-5
_TRIES_BESIDE = 20
_STATIONS_BESIDE = 0.15
_TARGETS_BESIDE = 0.03
_WIDE = 0.2
# Readings off by so many times the median of all say that there are gross errors. Then Huber's weights (1964), until
# none changes by more than this, and so often at most. Least squares may spread gross errors over all readings, so that
# none stands out: some millimetres leave no more than this misfit, m, and were the cause where these weights leave less
# than this share of it.
_WILD = 20.0
_SMEARED, _SPREAD = 1e-3, 0.2
_TUNING = 1.345
_AT_REST = 0.02
_REWEIGHTED = 15


@dataclass(frozen=True)
class Start:
    """First estimates."""

    stations: Array  # (S, 3) m, in the frame of the axis; the nominal one where a station read nothing
    targets: Array  # (T, 3) m, table frame
    misfit: float  # median absolute residual of the readings, m


# Starts by the digest of what they were found from: gross errors and mistakes are looked for by the same readings again
# and again. The newest so many.
_FOUND: dict[bytes, Start] = {}
_KEPT = 64


def find_start(table: TableReadings, stations: Array, targets: Array, *, tilted: bool = False) -> Start:
    """Fit stations and targets, from nominal (S, 3) and (T, 3), m, with the table turning without error.

    The datum of each run is taken out by subtracting the run's mean. If `tilted`, where the nominal places lead
    nowhere it is tried whether the axis stands tilted in the machine, by up to a right angle (then all stations are
    first turned together), and whether they are wrong by decimetres (then the fit sets out from places beside
    them).
    """
    readings, digest = table.readings, blake2b(bytes(tilted))
    for one in (stations, targets, table.rotation, readings.displacement, readings.setup, table.target, table.run):
        digest.update(np.ascontiguousarray(one).data)
    start = _FOUND.get(key := digest.digest())
    if start is None:
        start = _FOUND[key] = _start_from(table, stations, targets, tilted)
        while len(_FOUND) > _KEPT:
            _FOUND.pop(next(iter(_FOUND)), None)
    return start


def _start_from(table: TableReadings, stations: Array, targets: Array, tilted: bool) -> Start:
    start = _fitted(table, stations, targets)
    if _DOUBTFUL < start.misfit < _SMEARED:
        resisting = _fitted(table, stations, targets, resisting=True)
        start = resisting if resisting.misfit < _SPREAD * start.misfit else start
    if not tilted or start.misfit < _DOUBTFUL:
        return start
    if start.misfit > _ABSURD:
        start = _from_tilted(table, stations, targets, start)
    rng = np.random.default_rng(0)
    for _ in range(_TRIES_BESIDE):
        if start.misfit < _DOUBTFUL:
            break
        away = stations + _STATIONS_BESIDE * rng.normal(size=stations.shape)
        found = _fitted(table, away, targets + _TARGETS_BESIDE * rng.normal(size=targets.shape), _WIDE)
        start = min(start, found, key=lambda one: one.misfit)
    return start


def _from_tilted(table: TableReadings, stations: Array, targets: Array, start: Start) -> Start:
    turned = [_turned(stations, table.axis, tilt) for tilt in _tilts()]
    rough = [float(np.median(np.abs(_off(table, places, targets)))) for places in turned]
    posed = [_posed(table, turned[k], targets) for k in np.argsort(rough)[:_TRIES]]
    # The nearest to where the rotation is as stated is the one that fits; a mirror image may fit as well.
    tries = [_fitted(table, places, targets) for places in posed]
    return min([start, *tries], key=lambda found: found.misfit)


def _posed(table: TableReadings, stations: Array, targets: Array) -> Array:
    """All stations moved as one body to where the readings fit best, targets as stated."""
    arm, reading = table.turned(targets), table.readings.displacement
    count = np.bincount(table.run)

    def place(x: Array) -> Array:
        return np.asarray(Rotation.from_rotvec(x[3:]).apply(stations) + x[:3])

    def residual(x: Array) -> Array:
        off = np.linalg.norm(arm - place(x)[table.readings.setup], axis=1) - reading
        return np.asarray(off - (np.bincount(table.run, off) / count)[table.run])

    found = least_squares(residual, np.zeros(6), method="lm", xtol=1e-8, ftol=1e-8)
    return place(np.asarray(found.x))


def _tilts() -> list[tuple[float, float]]:
    """Turns about the two directions across the axis, rad: up to a right angle, beyond it would turn the other way."""
    around = np.arange(12) * np.pi / 6
    return [(a * np.cos(b), a * np.sin(b)) for a in np.radians([20, 40, 60, 75, 90]) for b in around]


def _turned(stations: Array, axis: str, tilt: tuple[float, float]) -> Array:
    along = "ABC".index(axis)
    vector = np.zeros(3)
    vector[(along + 1) % 3], vector[(along + 2) % 3] = tilt
    return np.asarray(Rotation.from_rotvec(-vector).apply(stations))


def _fitted(
    table: TableReadings, stations: Array, targets: Array, within: float = _NOMINAL, *, resisting: bool = False
) -> Start:
    """Reweighted while some readings are off by far more than the others, or always if `resisting`."""
    x = np.concatenate([stations.ravel(), targets.ravel()])
    off = np.abs(_off(table, stations, targets))
    usual = max(float(np.median(off)), 1e-9)  # m; 0 where most runs have a single reading
    weight = np.minimum(1.0, _WILD * usual / np.maximum(off, 1e-12)) ** 2
    for _ in range(_REWEIGHTED):
        x, left = _weighted(table, stations, targets, within, x, weight)
        scale = max(float(np.median(np.abs(left))) / NORMAL_MEDIAN, 1e-9)
        if not resisting and not (np.abs(left) > _WILD * scale).any() and (weight == 1.0).all():
            break
        before, weight = weight, np.minimum(1.0, _TUNING * scale / np.maximum(np.abs(left), 1e-12))
        if np.abs(weight - before).max() < _AT_REST:
            break
    size = stations.size
    return Start(x[:size].reshape(-1, 3), x[size:].reshape(-1, 3), float(np.median(np.abs(left))))


def _off(table: TableReadings, stations: Array, targets: Array) -> Array:
    """(n,) readings minus what the places say, from the middle of each run, m."""
    length = np.linalg.norm(table.turned(targets) - stations[table.readings.setup], axis=1)
    off = table.readings.displacement - length
    return np.asarray(off - group_ranges(off, table.run, len(table.run_key))[1][table.run])


def _weighted(
    table: TableReadings, stations: Array, targets: Array, within: float, start: Array, weight: Array
) -> tuple[Array, Array]:
    """Stations and targets by weighted least squares from a start, and (n,) the readings' residuals, m."""
    setup, reading = table.readings.setup, table.readings.displacement
    size = len(stations) * 3
    nominal = np.concatenate([stations.ravel(), targets.ravel()])
    count = np.bincount(table.run, weight)
    root = np.sqrt(weight)
    share = np.zeros((len(count), len(reading)))  # of each reading in its run's mean
    share[table.run, np.arange(len(reading))] = weight / count[table.run]

    def centred(values: Array) -> Array:
        return np.asarray(values - (np.bincount(table.run, weight * values) / count)[table.run])

    def split(x: Array) -> tuple[Array, Array]:
        return x[:size].reshape(-1, 3), x[size:].reshape(-1, 3)

    def line(x: Array) -> tuple[Array, Array]:
        s, t = split(x)
        away = table.turned(t) - s[setup]
        length = np.linalg.norm(away, axis=1)
        return length, away / np.maximum(length, 1e-12)[:, None]

    def residual(x: Array) -> Array:
        return np.concatenate([root * centred(line(x)[0] - reading) / _ERRORS, (x - nominal) / within])

    def jacobian(x: Array) -> Array:
        _, g = line(x)
        on_table = np.einsum("nij,ni->nj", table.rotation, g)
        out = np.zeros((len(reading), len(x)))
        rows = np.arange(len(reading))
        for j in range(3):
            out[rows, 3 * setup + j] = -g[:, j]
            out[rows, size + 3 * table.target + j] = on_table[:, j]
        out -= (share @ out)[table.run]
        return np.concatenate([root[:, None] * out / _ERRORS, np.eye(len(x)) / within])

    found = least_squares(residual, start, jacobian, method="lm", xtol=1e-9, ftol=1e-9, gtol=1e-9, max_nfev=60)
    return np.asarray(found.x), centred(line(found.x)[0] - reading)


# Share of the readings' range, and of the arrangement's size, that no rotary axis and no survey is wrong by; and the
# share of the misfit that is left without a mistake that is named.
_CONTRADICTS, _MISFIT_LEFT = 2e-3, 0.1
# A reading is off by an error of the axis, or by less than this, m.
_WRONG = 2e-3
# What a survey may be off by: m, or so many of its uncertainties.
_MISPLACED, _SURVEY_UNCERTAINTIES = 0.05, 20.0
SURVEYED = "state the stations to a decimetre and the targets to some centimetres"


def suppositions(session: Session) -> Iterator[Supposition]:
    """The measurement without each common mistake."""
    yield from turning_mistakes(session)
    yield from shifted(session, "displacement", session.readings.displacement)
    read = [session.setup_ids[k] for k in np.unique(session.readings.setup)]
    yield from exchanged(session, "setup", read)
    targets = np.unique(session.readings.labels["target"]).tolist()
    for setup in (None, *read):
        yield from exchanged(session, "target", targets, setup)


def refuse_mistakes(session: Session, start: Start) -> None:
    """Refuse (ModelError) readings that a table turning without error misses by far and a common mistake explains.

    Also looked at is where stations and targets had to be put: with all places free, exchanged ones fit perfectly,
    at each other's place.
    """
    description = session.description.as_a(RotaryAxis)
    stations, stations_u = _declared(description.setups)
    targets, targets_u = _declared(description.targets)

    def misfit(other: Session) -> float:
        table = table_readings(other)
        found = start if other is session else find_start(table, stations, targets)
        extent = max(float(np.ptp(table.readings.displacement)), 1e-12)
        used = np.unique(table.readings.setup)
        size = max(float(np.ptp(stations[used], axis=0).max()), 1e-3)
        turn, shift = best_motion(found.stations[used], stations[used])
        off = found.stations[used] @ turn.T + shift - stations[used]
        misplaced = _too_far(off, stations_u[used]) + _too_far(found.targets - targets, targets_u)
        return found.misfit / extent + misplaced / size

    what = explanation(session, [Judgement(misfit, suppositions(session), _CONTRADICTS, _CONTRADICTS, _MISFIT_LEFT)])
    if what is not None:
        with suspected():
            raise ModelError(f"{session.source}: the readings do not fit at all; they would without a mistake: {what}")


def refuse_wrong_rows(session: Session, start: Start, *, found: bool = True) -> None:
    """Refuse readings that a table turning without error misses by far, with what they look like (ModelError).

    Where stations and targets were `found`, those are the places at which most readings fit, and a run is judged by
    them; else they are the stated ones, and a station or a target is.
    """

    def held(other: Session) -> Iterator[Held]:
        table = table_readings(other)
        arm = table.turned(start.targets)
        path = np.linalg.norm(arm - start.stations[table.readings.setup], axis=1)
        off = off_prediction(other, path, table.run)
        allowed = np.full(len(off), _WRONG if found else _MISPLACED)
        if found:
            against = "the change of distance from where the station was found"
            yield Held("displacement", against, off, allowed, group=table.run)
            return

        def worst(owner: tuple[str, IntArray]) -> float:
            return float(np.nanmax(group_ranges(off, owner[1], int(owner[1].max()) + 1)[1]))

        against = "the change of distance between the stated places of station and target"
        for label, group in sorted((("", table.readings.setup), ("target", table.target)), key=worst, reverse=True):
            yield Held("displacement", against, off, allowed, group=group, label=label, hint=lambda setup: SURVEYED)

    read = session.with_readings(table_readings(session).readings)
    try:
        with suspected():
            refuse_contradictions(read, Place(session.source, session.source), held)
    except SessionError as error:
        raise ModelError(str(error)) from None


def _declared(entries: Sequence[StationSetup | Target]) -> tuple[Array, Array]:
    """(k, 3) stated places, m, and (k,) their uncertainties; 0 where none is stated."""
    places = np.array([entry.position for entry in entries])
    return places, np.array([entry.position_uncertainty or 0.0 for entry in entries])


def _too_far(moved: Array, declared: Array) -> float:
    """How much further the worst place is off than a survey can be, m."""
    allowed = np.maximum(_MISPLACED, _SURVEY_UNCERTAINTIES * declared)
    return float(np.max(np.clip(np.linalg.norm(moved, axis=1) - allowed, 0.0, None)))
