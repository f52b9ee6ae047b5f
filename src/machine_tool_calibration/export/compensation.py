# SPDX-License-Identifier: Apache-2.0
"""From an identification to a controller's files, and to what they would leave of the errors."""

from collections.abc import Sequence
from dataclasses import dataclass

from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.export import read_tables, remarks, write_tables
from machine_tool_calibration.export.error_states import ErrorStates, error_states
from machine_tool_calibration.export.preview import ResidualError, ResidualErrors, residual_errors, summary
from machine_tool_calibration.export.rotary import rotary_tables
from machine_tool_calibration.methods.axis_tables import SLOPES, AxisTables, axis_tables
from machine_tool_calibration.methods.identify import JointResult
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.session.provenance import Provenance


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
    if (turned := rotary_tables(result)) is not None:
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
