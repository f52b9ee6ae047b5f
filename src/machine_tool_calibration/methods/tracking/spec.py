# SPDX-License-Identifier: Apache-2.0
"""The tracking interferometer as a record."""

from machine_tool_calibration.methods.tracking.checks import TrackingChecks
from machine_tool_calibration.session.description import TrackingInterferometer
from machine_tool_calibration.session.method import MethodSpec

__all__ = ["SPEC"]


def _columns(description: TrackingInterferometer) -> tuple[str, ...]:
    angles: tuple[str, ...] = ()
    if description.pointing == "open_loop":
        angles = ("azimuth",) if description.dimension == 2 else ("azimuth", "elevation")
    return ("time", "setup", "repeat", *"xyz"[: description.dimension], *angles, "displacement")


def _words(description: TrackingInterferometer) -> str:
    pointing = "following the target" if description.pointing == "tracking" else "pointed open loop"
    return f"tracking interferometer in {description.dimension} dimensions, {pointing}"


SPEC = MethodSpec(
    description=TrackingInterferometer,
    columns=_columns,
    checks=TrackingChecks(),
    model="machine_tool_calibration.methods.tracking.model",
    map="machine_tool_calibration.methods.tracking.map",
    models={
        "free": "the default: every target has a position of its own, whatever moves the tool; each needs one "
        "station more than there are dimensions",
        "rigid_body": "the axes are rigid bodies, their errors tables over their positions: few stations do, other "
        "sessions can share the tables, and places between the targets are told",
    },
    words=_words,
    mounted=lambda description: "the instrument",
    turned_part=("the retroreflector", ("retroreflector_form",)),
    free_order=True,
    tables="rigid_body",
    by_axes=("rigid_body",),
    no_tables="the model 'free' has none; identify with --model rigid_body",
    steps="machine_tool_calibration.procedure.steps:path_steps",
    further_places="machine_tool_calibration.planning.places:further_stations",
    planned="machine_tool_calibration.planning.forecast:from_stations",
    optics="machine_tool_calibration.nodes.optics:on_tool",
    pictures="machine_tool_calibration.plots.tracking",
)
