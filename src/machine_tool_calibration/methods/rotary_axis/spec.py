# SPDX-License-Identifier: Apache-2.0
"""The rotary axis by multilateration as a record."""

from machine_tool_calibration.methods.rotary_axis.nominal import nominal_rotary
from machine_tool_calibration.session.checks.enough import enough_rotary
from machine_tool_calibration.session.description import RotaryAxis, rotary_column
from machine_tool_calibration.session.method import MethodSpec

__all__ = ["SPEC"]

SPEC = MethodSpec(
    name="rotary_axis",
    description=RotaryAxis,
    columns=lambda said: ("time", "setup", "repeat", "target", rotary_column(said), "displacement"),
    enough=enough_rotary,
    nominal=nominal_rotary,
    model="machine_tool_calibration.methods.rotary_axis.model",
    map="machine_tool_calibration.methods.rotary_axis.map",
    models={
        "free": "the only one: six error motions at every angle, targets and stations unknown",
    },
    setup_word="station",
    mounted=lambda description: "the instrument",
    beam_from_pointer=True,
    on_turning_table=True,
    turns_one_axis=True,
    counts_from_run=True,
    along="c",
    steps="machine_tool_calibration.procedure.steps:rotary_steps",
    further_places="machine_tool_calibration.planning.places:further_stations",
    planned="machine_tool_calibration.planning.forecast:to_table",
    optics="machine_tool_calibration.nodes.optics:OnTable",
    pictures="machine_tool_calibration.plots.rotary_axis",
)
