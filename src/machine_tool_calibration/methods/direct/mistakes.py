# SPDX-License-Identifier: Apache-2.0
"""A session of direct deviations that cannot be what it says."""

import itertools
from collections.abc import Callable, Iterator

import numpy as np

from machine_tool_calibration.arrays import NORMAL_MEDIAN, Array
from machine_tool_calibration.errors import ModelError, suspected
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.checks.mistakes import LENGTHS, UNITS, explanation, scaled, with_columns
from machine_tool_calibration.session.judgements import Judgement, Supposition
from machine_tool_calibration.session.session import Session

# Deviations of a machine tool, share of the travel: a tenth of a per cent would be a wreck.
_WRECK = 2e-3
# Deviations that are no larger are of a machine, however short its travel, m: read in another unit they would be those
# of none.
_PLAUSIBLE_DEVIATION = 2e-4
# Share of the positions by which readings may be off them that look like positions.
_READ = 0.02
# Residuals over declared uncertainty within which a fit is taken for good.
_GOOD = 30.0
# Share of the length that a part may lie askew, and that the deviations of a machine are at most.
_ASKEW, _USUAL = 6e-2, 5e-4
# No machine tool is as long, m.
_HALL = 100.0
# How closely the readings must follow that the part lay otherwise than it was described, and the share of the length
# that may be left of it.
_CLOSE, _LEFT = 0.02, 0.04
# Shear or difference of scales that no machine has, rad, without a turn of the part beside it: a turn read wrongly.
_SHEAR, _ALONE = 3e-3, 0.05

Build = Callable[[Session], MethodModel]


def refuse_mistakes(session: Session, build: Build) -> None:
    """Refuse (ModelError) positions given for deviations, a part turned or mirrored, and units a thousandfold wrong."""
    seen = build(session).observations
    extent = float(np.ptp(seen.position, axis=0).max())
    if extent == 0.0 or len(seen) < 8:
        return
    if extent > _HALL:
        what: str | None = f"x, y and z look {LENGTHS}"
    else:
        found = ((plane, _affine(seen, plane)) for plane in map(list, itertools.combinations(range(3), 2)))
        lying = (_lying(motion, plane) for plane, motion in found if motion is not None)
        what = next(filter(None, lying), None) or explanation(session, _judgements(session, build, extent))
    if what is not None:
        with suspected():
            raise ModelError(f"{session.source}: {what}")


def _judgements(session: Session, build: Build, extent: float) -> Iterator[Judgement]:
    # Single readings may be off by anything: the bulk counts.
    reading = session.readings.displacement
    spread = float(np.nanmedian(np.abs(reading - np.nanmedian(reading)))) / NORMAL_MEDIAN
    if spread < max(_WRECK * extent, _PLAUSIBLE_DEVIATION):
        return
    along = float(np.std(_along(session)))
    if along > 0.0:
        yield Judgement(lambda s: float(np.nanstd(s.readings.displacement)) / along, _read(session), _WRECK, _READ)

    # A part may lie askew, and a bed need not be level: what counts is what is left of the deviations.
    def left(supposed: Session) -> float:
        fit = fit_models([build(supposed)]).fits[0]
        seen, residuals = fit.model.observations, fit.residuals
        tilts = np.array([seen.position[:, i] * seen.direction[:, j] for i, j in itertools.permutations(range(3), 2)]).T
        residuals = residuals - tilts @ np.linalg.lstsq(tilts, residuals, rcond=1e-9)[0]
        return float(np.median(np.abs(residuals))) / extent

    units = [(factor, what) for factor, what in UNITS if spread * factor < _ASKEW * extent]
    yield Judgement(left, scaled(session, *units), max(_WRECK, _GOOD * session.sigma / extent), _USUAL)


def _along(session: Session) -> Array:
    """(n,) commanded places along the directions that are read, m."""
    readings = session.readings
    direction = np.column_stack([readings.column(name) for name in ("gx", "gy", "gz")])
    return np.asarray(np.sum(direction * readings.position(), axis=1) / np.linalg.norm(direction, axis=1))


def _read(session: Session) -> Iterator[Supposition]:
    for factor, name in (
        (1.0, "the actual position"),
        (-1.0, "commanded minus actual position"),
        (1e-3, "the actual position in millimetres"),
    ):
        what = f"displacement looks like {name}; a deviation is actual minus commanded"
        yield with_columns(session, what, displacement=factor * session.readings.displacement - _along(session))


def _affine(seen: Observations, plane: list[int]) -> Array | None:
    """(2, 2) how the deviations depend on the place, where they do so closely."""
    within = np.abs(np.linalg.norm(seen.direction[:, plane], axis=1) - 1.0) < 1e-6
    place, sense = seen.position[within][:, plane], seen.direction[within][:, plane]
    if len(place) < 12 or (np.ptp(place, axis=0) == 0).any() or (np.abs(sense).max(axis=0) < 0.5).any():
        return None
    reading, setup = seen.readings.displacement[within], seen.readings.setup[within]
    place = place - place.mean(axis=0)
    shifts = [(setup == s) * sense[:, j] for s in np.unique(setup) for j in range(2)]
    columns = np.array([*(place[:, j] * sense[:, i] for i in range(2) for j in range(2)), *shifts])
    found, _, rank, _ = np.linalg.lstsq(columns.T, reading, rcond=1e-9)
    left = float(np.median(np.abs(reading - found @ columns)))
    moved = float(np.sqrt(np.mean((found[:4] @ columns[:4]) ** 2)))
    return found[:4].reshape(2, 2) if rank == len(columns) and left <= _CLOSE * moved else None


def _lying(motion: Array, plane: list[int]) -> str | None:
    """How a plate lies, if its places and its deviations do not belong together: turned, mirrored or askew."""
    x, y = ("xyz"[j] for j in plane)
    for what, image in (
        (f"the part looks turned by 90 degrees in the plane of {x} and {y}", ((0, -1), (1, 0))),
        (f"the part looks turned by -90 degrees in the plane of {x} and {y}", ((0, 1), (-1, 0))),
        (f"the part looks turned by 180 degrees in the plane of {x} and {y}", ((-1, 0), (0, -1))),
        (f"{x} and {y} of the actual places look exchanged", ((0, 1), (1, 0))),
        (f"the actual places look mirrored: the sign of {x} is reversed", ((-1, 0), (0, 1))),
        (f"the actual places look mirrored: the sign of {y} is reversed", ((1, 0), (0, -1))),
    ):
        if np.abs(motion - np.array(image) + np.eye(2)).max() < _LEFT:
            return f"{what} against the commanded ones"
    size = _distortion(motion)
    if size > _SHEAR and _distortion(motion * [[1.0], [-1.0]]) < _ALONE * size:
        sign = f"the sign of those along {x} or along {y} looks reversed"
        return f"the deviations shear the plate by {1e3 * size:.1f} mrad without turning it: {sign}"
    if size > _SHEAR and _distortion(motion[:, ::-1]) < _ALONE * size:
        exchange = f"{x} and {y} look exchanged, in the places or in the deviations"
        return f"the deviations stretch {x} and shrink {y} by {1e3 * size:.1f} mrad: {exchange}"
    return None


def _distortion(motion: Array) -> float:
    """Shear or difference or mean of scales: all but the turn."""
    (xx, xy), (yx, yy) = motion
    return float(max(abs(xy + yx), abs(xx - yy), abs(xx + yy))) / 2
