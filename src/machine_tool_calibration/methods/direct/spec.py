# SPDX-License-Identifier: Apache-2.0
"""Deviations that are read directly, as a record."""

from machine_tool_calibration.methods.direct.checks import DirectChecks
from machine_tool_calibration.session.description import Direct
from machine_tool_calibration.session.method import MethodSpec

__all__ = ["SPEC"]

SPEC = MethodSpec(
    description=Direct,
    # real deviations often come without times and repeats: one pass, in the order given
    columns=lambda description: ("setup", "gx", "gy", "gz", "displacement"),
    any_axis=True,
    checks=DirectChecks(),
    model="machine_tool_calibration.methods.direct.model",
    models={
        "rigid_body": "the only one: the axes are rigid bodies, their errors tables over their positions",
    },
    mounted=lambda description: "" if description.datum == "none" else "the instrument or part",
    reads_deviations=True,
    reads_machine=True,
    by_axes=("rigid_body",),
    no_tables="the session names no terms (such as terms: [EXX, C0Y]) to be determined",
    steps="machine_tool_calibration.procedure.steps:direct_steps",
    planned="machine_tool_calibration.planning.forecast:directly",
    optics="machine_tool_calibration.nodes.optics:Along",
    pictures="machine_tool_calibration.plots.direct",
)
