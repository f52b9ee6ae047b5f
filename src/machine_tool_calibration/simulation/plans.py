# SPDX-License-Identifier: Apache-2.0
"""The plan of any method."""

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from machine_tool_calibration.simulation.circle_run import CirclePlan
from machine_tool_calibration.simulation.diagonal_run import DiagonalPlan
from machine_tool_calibration.simulation.direct_run import DirectPlan
from machine_tool_calibration.simulation.probing_run import ProbingPlan
from machine_tool_calibration.simulation.rotary_run import RotaryPlan
from machine_tool_calibration.simulation.tracking_run import TrackingPlan

AnyPlan = Annotated[
    TrackingPlan | DiagonalPlan | RotaryPlan | ProbingPlan | DirectPlan | CirclePlan, Field(discriminator="method")
]

PLANS = {
    str(plan.model_fields["method"].default): plan
    for plan in (DiagonalPlan, TrackingPlan, RotaryPlan, ProbingPlan, DirectPlan, CirclePlan)
}
"""The plan's class of each method."""

_FIFTH = (0.0, 0.02, 0.04, 0.06, 0.08, 0.1)

PRESETS: Mapping[str, AnyPlan] = {
    "tracking_2d": TrackingPlan(dimension=2),
    "tracking_3d": TrackingPlan(dimension=3),
    # 20 targets 20 mm apart on the edges of a square of 100 mm, three stations around it (the paper's Fig. 10; where
    # they stand is not printed: the first is 0.327 m from (100, 100), as Table 4 has 35.2 urad for 11.5 um there)
    "paper_003": TrackingPlan(
        dimension=2,
        stations=((-0.223, 0.05, 0.0), (0.05, -0.3, 0.0), (0.3, 0.28, 0.0)),
        points=tuple(
            [(x, 0.0, 0.0) for x in _FIFTH]
            + [(0.1, y, 0.0) for y in _FIFTH[1:]]
            + [(x, 0.1, 0.0) for x in _FIFTH[-2::-1]]
            + [(0.0, y, 0.0) for y in _FIFTH[-2:0:-1]]
        ),
        repeats=3,
        order="same",
    ),
    "step_diagonal": DiagonalPlan(),
    "step_diagonal_long": DiagonalPlan(
        step=(0.05, 0.05, 0.05), blocks=12, repeats=1, offset_linear=("xy", "xz", "yx", "yz", "zx", "zy")
    ),
    "step_diagonal_three_orders": DiagonalPlan(orders=("xyz", "yzx", "zxy"), repeats=1),
    "rotary_axis": RotaryPlan(),
    "rotary_axis_one_way": RotaryPlan(both_ways=False),
    "probing_cross": ProbingPlan(part="cross"),
    "probing_pins": ProbingPlan(part="pins"),
    "probing_cam": ProbingPlan(part="cam"),
    "probing_disc": ProbingPlan(part="disc"),
    "iso230_2": DirectPlan(kind="iso230_2", repeats=5),
    "straightness": DirectPlan(kind="straightness", repeats=3),
    "grid_plate": DirectPlan(kind="grid_plate", count=11, repeats=2, end=0.2),
    "ball_bar": CirclePlan(),
    "ball_bar_three_planes": CirclePlan(planes=("XY", "YZ", "ZX")),
    "drilled_plate": DirectPlan(kind="drilled_plate", count=16, end=0.45, noise=1e-6, interval=20.0),
}
"""Named plans: those of the papers and of the usual tests."""
