# SPDX-License-Identifier: Apache-2.0
"""A session of direct deviations that cannot be what it says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError, suspected
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.session import Session

__all__ = ["refuse_mistakes"]

# Deviations of a machine tool, share of the travel: a tenth of a per cent would be a wreck.
_WRECK = 2e-3
# Deviations that are no larger are of a machine, however short its travel, m: read in another unit they would be those
# of none.
_SMALL = 2e-4
# Share of the readings that a wrong reading explains before it is named.
_EXPLAINED = 0.99
# Residuals over declared uncertainty within which a fit is taken for good.
_GOOD = 30.0
# Share of the length that a part may lie askew, and that the deviations of a machine are at most.
_ASKEW, _USUAL = 6e-2, 5e-4
# No machine tool is as long, m.
_HALL = 100.0
# Share of the length by which places are off where the part lay otherwise than it was described, and how closely the
# readings must follow that.
_OFF, _CLOSE = 0.3, 0.02
# Shear or difference of scales that no machine has, rad, without a turn of the part beside it: a turn read wrongly.
_SHEAR, _ALONE = 3e-3, 0.05


def refuse_mistakes(session: Session, build: Callable[[Session], MethodModel]) -> None:
    """Refuse positions given for deviations, a part turned or mirrored, and units a thousand times too large.

    Args:
        session: the measurement.
        build: its model without machine errors, so that all deviations are left.

    Raises:
        ModelError: the mistake.
    """
    model = build(session)
    with suspected():
        _refuse(session, model, build)


def _refuse(session: Session, model: MethodModel, build: Callable[[Session], MethodModel]) -> None:
    readings, seen = session.readings, model.observations
    extent = float(np.ptp(seen.position, axis=0).max())
    if extent == 0.0 or len(seen) < 8:
        return
    reading = seen.readings.displacement
    if extent > _HALL:
        raise ModelError(f"{session.source}: x, y and z look like millimetres; lengths are in metres")
    if (lying := _lying(seen)) is not None:
        raise ModelError(f"{session.source}: {lying}")
    # Single readings may be off by anything: the bulk counts.
    spread = 1.4826 * float(np.median(np.abs(reading - np.median(reading))))
    if spread < max(_WRECK * extent, _SMALL):
        return
    along = np.einsum("nj,nj->n", seen.position, seen.direction)
    if (name := _position_read(reading, along)) is not None:
        raise ModelError(f"{session.source}: displacement looks like {name}; a deviation is actual minus commanded")
    # A part may lie askew: what counts is what is left of its deviations.
    if _left(model) < max(_WRECK * extent, _GOOD * session.sigma):
        return
    for factor, unit in ((1e-3, "millimetres"), (1e-6, "micrometres")):
        scaled = session.with_readings(replace(readings, displacement=factor * readings.displacement))
        if _left(build(scaled)) < _USUAL * extent and spread * factor < _ASKEW * extent:
            raise ModelError(f"{session.source}: displacement looks like {unit}; deviations are in metres")


def _lying(seen: Observations) -> str | None:
    """How a plate lies, if its places and its deviations do not belong together; None if they may."""
    for a, b in ((0, 1), (0, 2), (1, 2)):
        plane = [a, b]
        if (np.ptp(seen.position[:, plane], axis=0) == 0).any() or (
            np.abs(seen.direction[:, plane]).max(axis=0) < 0.5
        ).any():
            continue
        motion = _affine(seen, plane)
        if motion is None:
            continue
        names = ["xyz"[j] for j in plane]
        if np.abs(motion).max() > _OFF:
            return _turned(motion + np.eye(2), names)
        shear, stretch = (motion[0, 1] + motion[1, 0]) / 2, (motion[0, 0] - motion[1, 1]) / 2
        turn, scale = (motion[1, 0] - motion[0, 1]) / 2, (motion[0, 0] + motion[1, 1]) / 2
        sizes = {"shear": abs(shear), "stretch": abs(stretch)}
        largest = max(sizes, key=lambda name: sizes[name])
        others = [abs(turn), abs(scale), *(size for name, size in sizes.items() if name != largest)]
        if sizes[largest] < _SHEAR or max(others) > _ALONE * sizes[largest]:
            continue
        size = f"{1e3 * sizes[largest]:.1f} mrad"
        if largest == "shear":
            return (
                f"the deviations shear the plate by {size} without turning it: the sign of those along {names[0]} or "
                f"along {names[1]} looks reversed"
            )
        return (
            f"the deviations stretch {names[0]} and shrink {names[1]} by {size}: {names[0]} and {names[1]} look "
            "exchanged, in the places or in the deviations"
        )
    return None


def _affine(seen: Observations, plane: list[int]) -> Array | None:
    """(2, 2) how the deviations depend on the place; None where the readings do not tell or do not follow it."""
    within = np.abs(np.linalg.norm(seen.direction[:, plane], axis=1) - 1.0) < 1e-6
    if within.sum() < 12:
        return None
    place, sense = seen.position[within][:, plane], seen.direction[within][:, plane]
    reading, setup = seen.readings.displacement[within], seen.readings.setup[within]
    place = place - place.mean(axis=0)
    shifts = [(setup == s) * sense[:, j] for s in np.unique(setup) for j in range(2)]
    columns = np.array([*(place[:, j] * sense[:, i] for i in range(2) for j in range(2)), *shifts])
    found, _, rank, _ = np.linalg.lstsq(columns.T, reading, rcond=1e-9)
    left = reading - found @ columns
    moved = found[:4] @ columns[:4]
    if rank < len(columns) or float(np.median(np.abs(left))) > _CLOSE * float(np.sqrt(np.mean(moved**2)) or 1.0):
        return None
    return np.asarray(found[:4].reshape(2, 2))


def _turned(image: Array, names: list[str]) -> str | None:
    """What a plate that is imaged so has undergone, if it is a turn by right angles or a mirror."""
    known = {
        f"the part looks turned by 90 degrees in the plane of {names[0]} and {names[1]}": ((0, -1), (1, 0)),
        f"the part looks turned by -90 degrees in the plane of {names[0]} and {names[1]}": ((0, 1), (-1, 0)),
        f"the part looks turned by 180 degrees in the plane of {names[0]} and {names[1]}": ((-1, 0), (0, -1)),
        f"{names[0]} and {names[1]} of the actual places look exchanged": ((0, 1), (1, 0)),
        f"the actual places look mirrored: the sign of {names[0]} is reversed": ((-1, 0), (0, 1)),
        f"the actual places look mirrored: the sign of {names[1]} is reversed": ((1, 0), (0, -1)),
    }
    for words, matrix in known.items():
        if np.abs(image - np.array(matrix)).max() < _CLOSE * 2:
            return f"{words} against the commanded ones"
    return None


def _position_read(reading: Array, along: Array) -> str | None:
    """Whether the readings are the positions themselves."""
    centred, place = reading - reading.mean(), along - along.mean()
    power = float(place @ place)
    if power == 0.0:
        return None
    slope = float(centred @ place) / power
    left = float(np.sum((centred - slope * place) ** 2))
    if left > (1 - _EXPLAINED) * float(centred @ centred):
        return None
    if abs(abs(slope) - 1.0) < 0.02:
        return "the actual position" if slope > 0 else "commanded minus actual position"
    if abs(slope / 1000.0 - 1.0) < 0.02:
        return "the actual position in millimetres"
    return None


def _left(model: MethodModel) -> float:
    """Median absolute residual, m."""
    return float(np.median(np.abs(fit_models([model]).fits[0].residuals)))
