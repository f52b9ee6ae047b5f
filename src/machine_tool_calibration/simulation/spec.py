# SPDX-License-Identifier: Apache-2.0
"""What to simulate: the plan, the machine, the flaws, the noise."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator

from machine_tool_calibration.session.record import Finite, NotNegative, Positive, Record
from machine_tool_calibration.simulation.environment import COLUMNS
from machine_tool_calibration.simulation.machine_file import MachineSpec
from machine_tool_calibration.simulation.plans import AnyPlan

__all__ = ["Chips", "FlawSpec", "SimulationSpec", "Spread"]


class FlawSpec(Record):
    """One effect to put in.

    Attributes:
        id: the catalogue's id (RESULT.md), or an `unlisted_…` one.
        size: coefficient of the effect's formula, in its unit; typical if neither is given.
        amplitude: instead of the size: the largest change of any reading that the effect shall make, m.
        parameters: the effect's further coefficients (`tau`, `lead`, `phase`, …).
    """

    id: str
    size: Finite | None = None
    amplitude: Positive | None = None
    parameters: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check(self) -> FlawSpec:
        if self.size is not None and self.amplitude is not None:
            raise ValueError(f"effect {self.id}: give either size or amplitude")
        return self


class Spread(Record):
    """Irreproducibility between setups (mounting, slow heat): standard deviations per mounting, m.

    A mounting is a stretch of consecutive readings of one setup.

    Attributes:
        offset: one shift of all readings (seen only where readings are absolute).
        slope: readings drift from -slope to +slope over the setup.
        bow: a parabola over the setup, from +bow through -bow/2 to +bow.
    """

    offset: NotNegative = 0.0
    slope: NotNegative = 0.0
    bow: NotNegative = 0.0


class Chips(Record):
    """Readings that are wrong by a gross amount: a chip under the stylus, a broken beam.

    Attributes:
        fraction: of all readings, each by chance.
        size: scale of the error, m: between one and three times this, outwards for a probe.
    """

    fraction: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = 0.02
    size: Positive = 2e-5


class SimulationSpec(Record):
    """Everything that decides a simulated session; the same spec gives the same session.

    Attributes:
        plan: geometry and order of the readings; its `method` chooses the method.
        seed: of all that is random. Machine, set-up, environment, effects and noise have their own
            streams: adding an effect changes neither the machine nor the noise.
        machine: true errors; random ones of a good machining centre if absent.
        effects: what is put in.
        noise: standard uncertainty of a reading, m, as declared; the method's usual one if absent.
        noise_factor: the actual noise over the declared one (0: no noise).
        repeatability: standard deviation of the machine's position at each visit, per coordinate, m.
        spread: irreproducibility between setups.
        chips: gross errors.
        missing: fraction of readings that are lost.
        environment_swing: factor on all changes of temperature, pressure and humidity.
        environment_columns: what is recorded of the environment.
    """

    plan: AnyPlan
    seed: Annotated[int, Field(ge=0)] = 0
    machine: MachineSpec = MachineSpec()
    effects: tuple[FlawSpec, ...] = ()
    noise: Positive | None = None
    noise_factor: NotNegative = 1.0
    repeatability: NotNegative = 0.0
    spread: Spread = Spread()
    chips: Chips | None = None
    missing: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)] = 0.0
    environment_swing: NotNegative = 1.0
    environment_columns: tuple[str, ...] = COLUMNS

    @model_validator(mode="after")
    def _check(self) -> SimulationSpec:
        unknown = [name for name in self.environment_columns if name not in COLUMNS]
        if unknown:
            raise ValueError(f"environment_columns: {unknown[0]!r} is none of {', '.join(COLUMNS)}")
        return self

    @property
    def method(self) -> str:
        """The measuring method."""
        return self.plan.method
