# SPDX-License-Identifier: Apache-2.0
"""A contributor to the measurement uncertainty: one line of a budget.

Words as in the GUM (JCGM 100): type A or B, distribution, standard or expanded uncertainty, degrees of freedom. How it
enters the readings, and which of them share one value of it, decide what it does to a result.
"""

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from machine_tool_calibration.arrays import HALF_WIDTHS, Array, standard_draws
from machine_tool_calibration.session.record import Record
from machine_tool_calibration.session.values import Finite, Instrument, Positive

Enters = Literal[
    "reading", "along", "across", "angle", "length", "temperature", "air_temperature", "air_pressure", "air_humidity"
]
Varies = Literal["reading", "place", "angle", "run", "setup", "session", "never"]

UNITS: dict[str, str] = {
    "reading": "m", "along": "m", "across": "m", "angle": "rad", "length": "1", "temperature": "K",
    "air_temperature": "K", "air_pressure": "Pa", "air_humidity": "1",
}  # fmt: skip
"""Unit of a contributor's value, by how it enters."""

# Largest standard uncertainty of a value that enters by a length or an angle, in its unit: what is larger is a gross
# error, or was written in another unit.
_MOST = {"reading": 1e-3, "along": 1e-2, "across": 1e-2, "angle": 0.1, "length": 1e-2}

# Mean fourth power over the square of the variance.
_FOURTHS = {"normal": 3.0, "rectangular": 9.0 / 5.0, "triangular": 12.0 / 5.0, "arcsine": 3.0 / 2.0}


class Contributor(Record):
    """One line of an uncertainty budget."""

    name: Annotated[str, Field(min_length=1, max_length=80)]  # what it is
    symbol: Annotated[str, Field(max_length=20)] = ""  # as in u_11; may be absent
    type: Literal["A", "B"]  # A, evaluated from observations by statistics; B, otherwise
    distribution: Literal["normal", "rectangular", "triangular", "arcsine"] = "normal"  # of its value
    standard_uncertainty: Positive | None = None  # in the unit of `UNITS`; or instead of it
    expanded: Positive | None = None  # expanded uncertainty, with
    coverage_factor: Annotated[Finite, Field(gt=0)] | None = None  # k; or
    half_width: Positive | None = None  # of a distribution with ends
    # of a standard uncertainty that was evaluated; not said: known exactly
    degrees_of_freedom: Annotated[Finite, Field(ge=1)] | None = None
    enters: Enters  # what one unit of it does to a reading (`patterns.effect_on_readings`)
    # which readings share a value: one reading, or all of a place, beam direction, run, setup, session; never: all
    varies: Varies
    expansion: Annotated[Finite, Field(gt=0)] | None = None  # coefficient of expansion of what has the temperature, 1/K
    instrument: Instrument | Literal[""] = ""  # whose readings alone it enters; those of all if it is not said
    source: str = ""  # where the value is from

    @model_validator(mode="after")
    def _check(self) -> Self:
        sizes = [key for key in ("standard_uncertainty", "expanded", "half_width") if getattr(self, key) is not None]
        if len(sizes) != 1:
            said = " and ".join(sizes) or "none"
            raise ValueError(f"one of standard_uncertainty, expanded and half_width must be given, not {said}")
        if (self.expanded is None) != (self.coverage_factor is None):
            raise ValueError("expanded and coverage_factor belong together")
        if self.half_width is not None and self.distribution == "normal":
            raise ValueError("half_width is for rectangular, triangular and arcsine; a normal distribution has no ends")
        if (self.enters == "temperature") != (self.expansion is not None):
            raise ValueError("expansion (1/K) belongs to what enters by temperature, and only to that")
        if self.u > _MOST.get(self.enters, np.inf):
            size = f"{self.u:.3g} {self.unit}" if self.unit != "1" else f"{self.u:.3g} of the length"
            raise ValueError(f"a standard uncertainty of {size} is none of a measurement: values are in SI units")
        return self

    @property
    def u(self) -> float:
        """Standard uncertainty, in the unit of `UNITS`."""
        if self.half_width is not None:
            return self.half_width / HALF_WIDTHS[self.distribution]
        if self.expanded is not None and self.coverage_factor is not None:
            return self.expanded / self.coverage_factor
        return float(self.standard_uncertainty or 0.0)

    @property
    def unit(self) -> str:
        """Of its value."""
        return UNITS[self.enters]

    @property
    def fourth(self) -> float:
        """Mean fourth power of its value over the square of its variance."""
        return _FOURTHS[self.distribution]

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """(count,) independent values; of a few degrees of freedom by the t-distribution (JCGM 101, 6.4.9)."""
        if self.distribution == "normal" and self.degrees_of_freedom is not None:
            return np.asarray(self.u * rng.standard_t(self.degrees_of_freedom, count))
        return self.u * standard_draws(self.distribution, rng, count)


def _check_names(lines: tuple[Contributor, ...]) -> tuple[Contributor, ...]:
    names = [line.name for line in lines]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"contributors has the name {twice[0]!r} twice")
    return lines


Contributors = Annotated[tuple[Contributor, ...], Field(max_length=1000), AfterValidator(_check_names)]
"""The lines of a budget, with names that differ."""
