# SPDX-License-Identifier: Apache-2.0
"""The step diagonal as a record."""

from machine_tool_calibration.methods.step_diagonal.checks import DiagonalChecks
from machine_tool_calibration.session.description import StepDiagonal
from machine_tool_calibration.session.method import MethodSpec

__all__ = ["SPEC"]

SPEC = MethodSpec(
    description=StepDiagonal,
    columns=lambda description: ("time", "setup", "repeat", "x", "y", "z", "displacement"),
    checks=DiagonalChecks(),
    model="machine_tool_calibration.methods.step_diagonal.build",
    map="machine_tool_calibration.methods.step_diagonal.model",
    models={
        "small_angles": "the default: position errors of the axes; angular errors are zero or small smooth random "
        "functions, of a size that the readings determine as far as they can",
        "translations": "the machine has no angular errors, or they are known to be negligible: fewer unknowns",
        "angular": "every diagonal was run in several orders of the moves: the angular errors that these determine "
        "are found",
        "angular_one_mirror": "the same, and the mirror was not touched between the orders of a diagonal",
        "aligned_mirror": "no angular errors, and mirrors exactly square to their beams, as the conventional "
        "formulation assumes: only to compare with it",
    },
    mounted=lambda description: "the mirror",
    states_runs=True,
    counts_from_run=True,
    steps="machine_tool_calibration.procedure.steps:diagonal_steps",
    further_places="machine_tool_calibration.planning.places:further_runs",
    planned="machine_tool_calibration.planning.forecast:along_diagonals",
    optics="machine_tool_calibration.nodes.optics:FlatMirror",
)
