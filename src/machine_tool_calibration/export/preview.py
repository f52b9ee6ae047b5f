# SPDX-License-Identifier: Apache-2.0
"""What would be left of the measured errors once a controller compensates: a wrong sign shows as twice the error."""

from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, rigid_motions, rms
from machine_tool_calibration.methods.axis_tables import AxisTables
from machine_tool_calibration.model.result import ErrorMap

_PARTS = ("x", "y", "z")
# Ratio up to which errors are the same: the shift and turn that are taken out differ a little before and after.
_SAME_RATIO = 1.002


@dataclass(frozen=True)
class ResidualError:
    """The position error in one direction, or its length, over the points of the error map, m."""

    name: str  # x, y, z, or `length`
    rms_before: float  # root mean square as measured
    rms_after: float  # with the compensation
    largest_before: float  # as measured
    largest_after: float  # with the compensation
    uncertainty: float  # root mean square standard uncertainty of the measured error
    # expected of the machine now and with the files: the error, and what it is uncertain by
    rms_now: float
    rms_left: float
    largest_now: float  # at any point at most, with 95 %: the error there, and its U (95 %)
    largest_left: float

    @property
    def worse(self) -> bool:
        """Whether the compensation would do harm."""
        return self.rms_after > _SAME_RATIO * self.rms_before

    @property
    def larger(self) -> bool:
        """Whether the compensation would make the largest error larger."""
        return self.largest_after > _SAME_RATIO * self.largest_before


@dataclass(frozen=True)
class ResidualErrors:
    """Position errors at the points of a map without what a shift and a turn of the whole would explain.

    The workpiece's origin and direction are set on the machine, and the data of most methods leave them open.
    """

    points: Array  # (n, 3) commanded, m
    before: Array  # (n, 3) as measured, m; zero where it is not known
    after: Array  # (n, 3) with the compensation, m; zero where it is not known
    uncertainty: Array  # (n, 3) standard uncertainty of the measured errors, m
    known: BoolArray  # (n, 3) whether the error was determined


def residual_errors(error_map: ErrorMap, compensation: AxisTables, directions: Array | None = None) -> ResidualErrors:
    """Errors before and after what the files take away, the latter with backlash where directions (n, 3) are given."""
    known = np.isfinite(error_map.error)
    predicted = compensation.field(error_map.points, directions)
    before = _without_motion(error_map.points, np.where(known, error_map.error, 0.0), known)
    after = _without_motion(error_map.points, np.where(known, error_map.error - predicted, 0.0), known)
    return ResidualErrors(error_map.points, before, after, np.where(known, error_map.uncertainty, 0.0), known)


def summary(errors: ResidualErrors) -> tuple[ResidualError, ...]:
    """Figures for each direction that is known, and for the length at last."""
    out = []
    for j, name in enumerate(_PARTS):
        at = errors.known[:, j]
        if at.any():
            out.append(_residual_error(name, errors.before[at, j], errors.after[at, j], errors.uncertainty[at, j]))
    lengths = [np.linalg.norm(part, axis=1) for part in (errors.before, errors.after, errors.uncertainty)]
    return (*out, _residual_error("length", *lengths))


def _residual_error(name: str, before: Array, after: Array, spread: Array) -> ResidualError:
    def largest(values: Array) -> float:
        return float(np.abs(values).max())

    u = rms(spread)
    return ResidualError(
        name,
        rms_before=rms(before),
        rms_after=rms(after),
        largest_before=largest(before),
        largest_after=largest(after),
        uncertainty=u,
        rms_now=float(np.hypot(rms(before), u)),
        rms_left=float(np.hypot(rms(after), u)),
        largest_now=largest(np.abs(before) + 2.0 * spread),
        largest_left=largest(np.abs(after) + 2.0 * spread),
    )


def _without_motion(points: Array, error: Array, known: Array) -> Array:
    """(n, 3) the error less its least-squares shift and turn; zero where it is not known."""
    mask = known.ravel().astype(float)
    matrix = rigid_motions(points - points.mean(axis=0)).reshape(-1, 6) * mask[:, None]
    size = np.linalg.norm(matrix, axis=0)
    matrix = matrix[:, size > 1e-12] / size[size > 1e-12]
    fitted = matrix @ np.linalg.lstsq(matrix, error.ravel() * mask, rcond=1e-9)[0]
    return np.asarray((error.ravel() * mask - fitted).reshape(-1, 3))
