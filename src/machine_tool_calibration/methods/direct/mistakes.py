# SPDX-License-Identifier: Apache-2.0
"""A session of direct deviations that cannot be what it says."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError, suspected
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.checks.mistakes import LENGTHS, UNITS, explanation, scaled, with_columns
from machine_tool_calibration.session.judgements import Judgement, Supposition
from machine_tool_calibration.session.session import Session

__all__ = ["refuse_mistakes"]

# Deviations of a machine tool, share of the travel: a tenth of a per cent would be a wreck.
_WRECK = 2e-3
# Deviations that are no larger are of a machine, however short its travel, m: read in another unit they would be those
# of none.
_SMALL = 2e-4
# Share of the positions by which readings may be off them that look like positions.
_READ = 0.02
# Residuals over declared uncertainty within which a fit is taken for good.
_GOOD = 30.0
# Share of the length that a part may lie askew, and that the deviations of a machine are at most.
_ASKEW, _USUAL = 6e-2, 5e-4
# No machine tool is as long, m.
_HALL = 100.0
# Share of the length by which places are off where the part lay otherwise than it was described, how closely the
# readings must follow that, and what may be left.
_OFF, _CLOSE, _LEFT = 0.3, 0.02, 0.04
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
        what = explanation(session, _judgements(session, build, seen, extent))
    if what is not None:
        with suspected():
            raise ModelError(f"{session.source}: {what}")


def _judgements(session: Session, build: Build, seen: Observations, extent: float) -> Iterator[Judgement]:
    def observed(supposed: Session) -> Observations:
        return seen if supposed is session else build(supposed).observations

    for a, b in itertools.combinations(range(3), 2):
        yield from _lying(session, observed, [a, b])
    # Single readings may be off by anything: the bulk counts.
    reading = session.readings.displacement
    spread = 1.4826 * float(np.nanmedian(np.abs(reading - np.nanmedian(reading))))
    if spread < max(_WRECK * extent, _SMALL):
        return
    along = float(np.std(_along(session, np.eye(3))))
    if along > 0.0:
        yield Judgement(lambda s: float(np.nanstd(s.readings.displacement)) / along, _read(session), _WRECK, _READ)

    # A part may lie askew: what counts is what is left of its deviations.
    def left(supposed: Session) -> float:
        return float(np.median(np.abs(fit_models([build(supposed)]).fits[0].residuals))) / extent

    units = [(factor, what) for factor, what in UNITS if spread * factor < _ASKEW * extent]
    yield Judgement(left, scaled(session, *units), max(_WRECK, _GOOD * session.sigma / extent), _USUAL)


def _along(session: Session, image: Array) -> Array:
    """(n,) commanded places imaged by (3, 3), along the directions that are read, m."""
    readings = session.readings
    direction = np.column_stack([readings.column(name) for name in ("gx", "gy", "gz")])
    sensed = np.einsum("nj,jk,nk->n", direction, image, readings.position())
    return np.asarray(sensed / np.linalg.norm(direction, axis=1))


def _less(session: Session, what: str, image: Array, factor: float = 1.0) -> Supposition:
    """Displacements, times a factor, that have the imaged places in them."""
    deviation = factor * session.readings.displacement - _along(session, image)
    return Supposition(what, session.with_readings(replace(session.readings, displacement=deviation)))


def _read(session: Session) -> Iterator[Supposition]:
    """Positions in the place of deviations."""
    for factor, name in (
        (1.0, "the actual position"),
        (-1.0, "commanded minus actual position"),
        (1e-3, "the actual position in millimetres"),
    ):
        what = f"displacement looks like {name}; a deviation is actual minus commanded"
        yield _less(session, what, np.eye(3), factor)


def _lying(session: Session, observed: Callable[[Session], Observations], plane: list[int]) -> Iterator[Judgement]:
    """How a plate lies, if its places and its deviations do not belong together."""

    def motion(session: Session) -> tuple[Array, bool]:
        return _affine(observed(session), plane)

    def turned(session: Session) -> float:
        return float(np.abs(motion(session)[0]).max())

    def distorted(session: Session) -> float:
        (xx, xy), (yx, yy) = motion(session)[0]
        return float(max(abs(xy + yx), abs(xx - yy), abs(xx + yy))) / 2

    if motion(session)[1]:
        yield Judgement(turned, _turns(session, plane), _OFF, _LEFT)
        yield Judgement(distorted, _askew(session, plane, distorted(session)), _SHEAR, np.inf, _ALONE)


def _affine(seen: Observations, plane: list[int]) -> tuple[Array, bool]:
    """(2, 2) how the deviations depend on the place, and whether they do so closely; NaN where nothing shows it."""
    within = np.abs(np.linalg.norm(seen.direction[:, plane], axis=1) - 1.0) < 1e-6
    place, sense = seen.position[within][:, plane], seen.direction[within][:, plane]
    if len(place) < 12 or (np.ptp(place, axis=0) == 0).any() or (np.abs(sense).max(axis=0) < 0.5).any():
        return np.full((2, 2), np.nan), False
    reading, setup = seen.readings.displacement[within], seen.readings.setup[within]
    place = place - place.mean(axis=0)
    shifts = [(setup == s) * sense[:, j] for s in np.unique(setup) for j in range(2)]
    columns = np.array([*(place[:, j] * sense[:, i] for i in range(2) for j in range(2)), *shifts])
    found, _, rank, _ = np.linalg.lstsq(columns.T, reading, rcond=1e-9)
    left = float(np.median(np.abs(reading - found @ columns)))
    moved = float(np.sqrt(np.mean((found[:4] @ columns[:4]) ** 2)))
    return found[:4].reshape(2, 2), bool(rank == len(columns) and left <= _CLOSE * (moved or 1.0))


def _turns(session: Session, plane: list[int]) -> Iterator[Supposition]:
    """A part turned by right angles, or mirrored."""
    x, y = ("xyz"[j] for j in plane)
    for what, image in (
        (f"the part looks turned by 90 degrees in the plane of {x} and {y}", ((0, -1), (1, 0))),
        (f"the part looks turned by -90 degrees in the plane of {x} and {y}", ((0, 1), (-1, 0))),
        (f"the part looks turned by 180 degrees in the plane of {x} and {y}", ((-1, 0), (0, -1))),
        (f"{x} and {y} of the actual places look exchanged", ((0, 1), (1, 0))),
        (f"the actual places look mirrored: the sign of {x} is reversed", ((-1, 0), (0, 1))),
        (f"the actual places look mirrored: the sign of {y} is reversed", ((1, 0), (0, -1))),
    ):
        moved = np.zeros((3, 3))
        moved[np.ix_(plane, plane)] = np.array(image) - np.eye(2)
        yield _less(session, f"{what} against the commanded ones", moved)


def _askew(session: Session, plane: list[int], distorted: float) -> Iterator[Supposition]:
    """A part that lay askew, its deviations read with a wrong sign or with axes exchanged."""
    columns, (x, y), size = session.readings.columns, ("xyz"[j] for j in plane), f"{1e3 * distorted:.1f} mrad"
    what = f"shear the plate by {size} without turning it: the sign of those along {x} or along {y} looks reversed"
    yield with_columns(session, f"the deviations {what}", **{f"g{y}": -columns[f"g{y}"]})
    what = f"stretch {x} and shrink {y} by {size}: {x} and {y} look exchanged, in the places or in the deviations"
    yield with_columns(session, f"the deviations {what}", **{x: columns[y], y: columns[x]})
