# SPDX-License-Identifier: Apache-2.0
"""The rotary axis by multilateration as a record."""

from machine_tool_calibration.methods.rotary_axis.checks import RotaryChecks
from machine_tool_calibration.session.description import RotaryAxis, rotary_column
from machine_tool_calibration.session.method import MethodSpec

__all__ = ["SPEC"]

SPEC = MethodSpec(
    description=RotaryAxis,
    columns=lambda said: ("time", "setup", "repeat", "target", rotary_column(said), "displacement"),
    checks=RotaryChecks(),
    model="machine_tool_calibration.methods.rotary_axis.model",
    map="machine_tool_calibration.methods.rotary_axis.map",
    models={
        "free": "the only one: six error motions at every angle, targets and stations unknown",
    },
    mounted=lambda description: "the instrument",
    turns_one_axis=True,
    counts_from_run=True,
    steps="machine_tool_calibration.procedure.steps:rotary_steps",
    further_places="machine_tool_calibration.planning.places:further_stations",
    planned="machine_tool_calibration.planning.forecast:to_table",
    optics="machine_tool_calibration.nodes.optics:OnTable",
    pictures="machine_tool_calibration.plots.rotary_axis",
)
