"""The common part of every plan: what a measurement's geometry is made of."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.random_machine import Amplitudes

__all__ = ["Finite", "Plan", "Positive", "Vector3"]

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]


class Plan(BaseModel):
    """Where and when readings are taken.

    Attributes:
        repeats: how often each setup is run.
        interval: time between readings, s.
        pause: time to set up the instrument anew, s.
        noise: usual standard uncertainty of a reading, m.
        sign: sense in which a rotary axis commanded positive turns the workpiece (+1: counter-clockwise).
        chain: chain of axes.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    repeats: Annotated[int, Field(ge=1, le=10000)] = 1
    interval: Positive = 4.0
    pause: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 600.0
    noise: Positive = 3e-7
    sign: Literal[-1, 1] = 1
    chain: str = "w-C-b-Y-X-Z-t"

    def travel(self) -> dict[str, tuple[float, float]]:
        """Ends of the linear axes' travel, by letter, m."""
        return {}

    def prepared(self, machine: VirtualMachine) -> VirtualMachine:
        """The machine as the plan wants it."""
        return machine

    def errors(self) -> Amplitudes | None:
        """Sizes of random errors that suit the method; None for the usual ones."""
        return None
