# SPDX-License-Identifier: Apache-2.0
"""The probing of a part on a rotary table as a record."""

from machine_tool_calibration.methods.probing.checks import ProbingChecks
from machine_tool_calibration.session.description import Probing
from machine_tool_calibration.session.method import MethodSpec

__all__ = ["SPEC"]

SPEC = MethodSpec(
    description=Probing,
    columns=lambda description: ("time", "setup", "repeat", "point", "x", "y", "c", "displacement"),
    checks=ProbingChecks(),
    model="machine_tool_calibration.methods.probing.model",
    map="machine_tool_calibration.methods.probing.map",
    models={
        "rigid_body": "the only one: the part has a form of its own, the axes are rigid bodies with tables of errors",
    },
    mounted=lambda description: "",
    turned_part=("the probe", ("probe_pretravel",)),
    reads_deviations=True,
    probes_surface=True,
    steps="machine_tool_calibration.procedure.steps:touch_steps",
    further_places="machine_tool_calibration.planning.places:further_angles",
    planned="machine_tool_calibration.planning.forecast:touching",
    pictures="machine_tool_calibration.plots.probing",
)
