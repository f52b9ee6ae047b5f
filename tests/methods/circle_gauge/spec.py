# SPDX-License-Identifier: Apache-2.0
"""Circles with a length gauge between table and tool in the XY plane (ISO 230-4), as a record."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from machine_tool_calibration.session.description import Description, Setup
from machine_tool_calibration.session.method import MethodSpec
from machine_tool_calibration.session.values import Positive, Vector3


class CircleSetup(Setup):
    """The centre of a circle where it is meant to be, m, and the nominal length of the bar, m."""

    centre: Vector3
    radius: Positive


class CircleGauge(Description):
    """Deviations of the distance between tool and centre from the nominal radius."""

    reads: ClassVar[str | None] = "ball_bar"

    method: Literal["circle_gauge"]
    setups: Annotated[tuple[CircleSetup, ...], Field(min_length=1)]


class CircleSpec(MethodSpec):
    """A centre, a length and the machine's errors need six readings."""

    description = CircleGauge
    always = ("setup", "x", "y", "displacement")
    needed = 6
    remounted = "the gauge"
    model = "circle_gauge.model"
    models: ClassVar = {"circle": "the only one"}
    reads_deviations = True

    def words(self, description: CircleGauge) -> str:
        """What it is."""
        return "circles with a gauge"


SPEC = CircleSpec()
