# SPDX-License-Identifier: Apache-2.0
"""From an identification to a controller's files, and to what they would leave of the errors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, rigid_motions, rms
from machine_tool_calibration.coverage import K
from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.export import read_tables, remarks, write_tables
from machine_tool_calibration.export.error_states import ErrorStates, error_states
from machine_tool_calibration.export.rotary import rotary_tables
from machine_tool_calibration.methods.axis_tables import SLOPES, AxisTables, axis_tables
from machine_tool_calibration.methods.identify import JointResult
from machine_tool_calibration.model.result import ErrorMap, Result
from machine_tool_calibration.session.provenance import Provenance

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
        """Whether the compensation would make the largest error larger, by more than what it is uncertain by."""
        grown = self.largest_after - self.largest_before
        return grown > max((_SAME_RATIO - 1.0) * self.largest_before, K * self.uncertainty)


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


@dataclass(frozen=True)
class Exported:
    """What a controller is given."""

    files: dict[str, str]  # texts by name
    errors: ResidualErrors  # at the points of the map before and after, as the controller reads the files
    left: tuple[ResidualError, ...]  # figures of them
    # what is in the model, displaces the tool, and is not in the files: effects first, then error motions
    absent: list[str]
    complete: bool = False  # whether the uncertainties are those of a budget
    remarks: tuple[str, ...] = ()  # what whoever loads the files would find otherwise

    @property
    def worse(self) -> bool:
        """Whether the errors would grow."""
        return self.left[-1].worse

    @property
    def worse_along(self) -> list[ResidualError]:
        """Directions in which the errors would grow."""
        return [one for one in self.left[:-1] if one.worse]


@dataclass(frozen=True)
class Compensation:
    """What can be compensated of a machine's errors."""

    tables: AxisTables  # it
    states: ErrorStates  # the errors at the points of the map, with what effects do in each direction of approach
    source: str  # which measurement it is from
    origin: Provenance  # what it was made from
    complete: bool = False  # whether the uncertainties are those of a budget

    def exported(self, form: str) -> Exported:
        """The files of a controller, read back as it does; a CalibrationError if it cannot hold these tables."""
        told = (f"{name}: {value}" for name, value in self.origin.lines() if name != "model")  # in every head already
        files = write_tables(form, self.tables, "\n".join([self.source, *told]))
        held = read_tables(form, files, self.tables)
        errors = residual_errors(self.states.error_map, held, self.states.directions)
        absent = _absent(self.tables, held, self.states.effects)
        return Exported(files, errors, summary(errors), absent, self.complete, tuple(remarks(form, self.tables)))


def compensation(result: Result | JointResult, source: str, own: Sequence[Effect] = ()) -> Compensation:
    """What can be compensated of the errors that were identified; `source` is its name in the files' heads."""
    effects, complete = find_effects(result.effects, own), result.variance_added is not None
    if (turned := rotary_tables(result, effects)) is not None:
        own_states = turned.states(result.error_map, effects)
        return Compensation(turned, own_states, source, result.provenance, complete)
    states = error_states(result.error_map, result.joint.fits, effects)
    return Compensation(axis_tables(result), states, source, result.provenance, complete)


def _absent(tables: AxisTables, held: AxisTables, effects: Sequence[str]) -> list[str]:
    taken = {f"backlash_{axis.lower()}" for axis in held.backlash}
    named = {*(table.name for table in held.tables), *held.squareness}
    # where squareness is not said apart, it is the slope of a straightness
    named |= {name for name, slope in SLOPES.items() if slope in named}
    known = [*(table.name for table in tables.tables), *tables.squareness]
    return [*(e for e in effects if e not in taken), *(name for name in known if name not in named)]
