# SPDX-License-Identifier: Apache-2.0
"""What `session.yaml` says of circles with a double ball bar (ISO 230-4)."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from machine_tool_calibration.session.description import Description, Setup
from machine_tool_calibration.session.values import Positive, Vector3


class CircleSetup(Setup):
    """A circle: its two axes, the centre where it is meant to be, m, the bar's nominal length, m.

    Attributes:
        plane: counter-clockwise is from its first axis towards its second.
        feed: path speed, m/s, where the readings do not say it in a column `feed`.
    """

    plane: Literal["XY", "YZ", "ZX"]
    centre: Vector3
    radius: Positive
    feed: Positive | None = None


class BallBar(Description):
    """Deviations of the distance between tool and centre from the bar's nominal length, all around."""

    reads: ClassVar[str | None] = "ball_bar"

    method: Literal["ball_bar"]
    setups: Annotated[tuple[CircleSetup, ...], Field(min_length=1)]
    # standard uncertainty of the bar's length, m: of one that was calibrated, radial deviations are reported
    length_uncertainty: Positive | None = None

    @model_validator(mode="after")
    def _check_axes(self) -> BallBar:
        linear = self.machine.kinematics.linear
        for setup in self.setups:
            for axis in setup.plane:
                if axis not in linear:
                    raise ValueError(
                        f"setup {setup.id} is in {setup.plane}, and the chain {self.machine.chain} has no axis {axis}"
                    )
        return self
