# SPDX-License-Identifier: Apache-2.0
"""A user's own effect by formula, from a YAML file or the command line.

effects:
- id: creep_y
title: creep of the Y slide after a move
enters: y                  # x, y, z: displacement of that axis; reading: the reading itself
formula: b * dir_y * exp(-time / tau)
coefficients: {b: {unit: m, low: -1.0e-5, high: 1.0e-5}}
shapes: {tau: {unit: s, low: 10, high: 1.0e4}}
columns: {my_column: K}     # units of columns of your own, if they shall be checked
constants: {k0: {value: 2.5, unit: 1/s}}
"""

from __future__ import annotations

import re
from pathlib import Path
from tokenize import TokenError
from typing import Annotated, Any, Literal

import numpy as np
import pint
from pydantic import Field, model_validator

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect, Shape, axis_unit
from machine_tool_calibration.effects.expression import parse, registry
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.defects import validated
from machine_tool_calibration.session.record import Record
from machine_tool_calibration.session.text import read_text
from machine_tool_calibration.session.values import Finite
from machine_tool_calibration.session.yaml_text import load_yaml

__all__ = ["FormulaEffect", "checked_definition", "formula_effect", "read_effects"]

_UNITS = {
    "time": "s", "x": "m", "y": "m", "z": "m", "c": "rad", "azimuth": "rad", "elevation": "rad", "path": "m",
    "displacement": "m",
    "temperature_air": "K", "temperature_x": "K", "temperature_y": "K", "temperature_z": "K", "temperature_table": "K",
    "temperature_work": "K", "air_pressure": "Pa", "relative_humidity": "1", "repeat": "1", "pi": "1",
    "dir_x": "1", "dir_y": "1", "dir_z": "1", "dir_c": "1",
}  # fmt: skip
"""Units of a session's columns. Temperatures count in kelvin: only differences mean something in a formula."""

# Names of units with small powers, multiplied and divided: of anything else the library of units tries to make a
# number, and 9**9**9**9 takes for ever.
_POWER = r"[(\s]*(?:[^\W\d]|[°%])+(?:\s*(?:\*\*|\^)\s*-?\d\d?(?:\.\d)?)?[)\s]*"
_UNIT = re.compile(rf"1|(?:1\s*/)?{_POWER}(?:[*/ ]{_POWER})*")
_LONGEST_UNIT = 60
_GRID = 12
_LARGEST_FILE = 1 << 20


class _Unknown(Record):
    unit: str = "1"
    low: Finite
    high: Finite
    meaning: str = ""

    @model_validator(mode="after")
    def _check(self) -> _Unknown:
        if not self.low < self.high:
            raise ValueError(f"it must run from low to high, not {self.low:g} to {self.high:g}")
        return self


class _Constant(Record):
    value: Finite
    unit: str = "1"


class _Definition(Record):
    id: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,60}$")]
    title: str = ""
    enters: Literal["x", "y", "z", "reading"]
    formula: str
    coefficients: Annotated[dict[str, _Unknown], Field(min_length=1)]
    shapes: Annotated[dict[str, _Unknown], Field(max_length=1)] = Field(default_factory=dict)
    columns: dict[str, str] = Field(default_factory=dict)
    constants: dict[str, _Constant] = Field(default_factory=dict)
    source: str = "the user's own formula"


class FormulaEffect(Effect):
    """An effect of the user's own: linear in its coefficients, with at most one nonlinear one."""

    def __init__(self, definition: _Definition) -> None:
        """Check the formula.

        Raises:
            ModelError: the formula cannot be parsed, is not linear in its coefficients, or its units do not fit.
        """
        try:
            self._build(definition)
        except ModelError as error:
            raise ModelError(f"effect {definition.id}: {error}") from None

    def _build(self, definition: _Definition) -> None:
        self._definition = definition
        self.definition = definition.model_dump(mode="json", exclude_defaults=True)
        self._expression = parse(definition.formula)
        self.id = definition.id
        self.title = definition.title or definition.id
        self.formula = (
            f"{'reading' if definition.enters == 'reading' else 'e_' + definition.enters} = {definition.formula}"
        )
        self.source = definition.source
        self.kind = "reading" if definition.enters == "reading" else "position"
        self.coefficients = tuple(
            Coefficient(n, u.unit, u.low, u.high, u.meaning) for n, u in definition.coefficients.items()
        )
        self.shapes = tuple(Shape(n, u.unit, u.low, u.high, meaning=u.meaning) for n, u in definition.shapes.items())
        own = set(definition.coefficients) | set(definition.shapes) | set(definition.constants) | {"pi"}
        unused = set(definition.coefficients) | set(definition.shapes)
        for name in sorted(unused - self._expression.names):
            raise ModelError(f"the formula does not hold the coefficient {name!r}")
        self._columns = tuple(sorted(self._expression.names - own - {"path", "displacement"}))
        self.needs = self._columns
        self.covariates = tuple(sorted(self._expression.names - own))
        self._check_linear()
        self._check_units()

    def _check_units(self) -> None:
        definition = self._definition
        units = _UNITS | definition.columns
        units |= {n: u.unit for n, u in (definition.coefficients | definition.shapes).items()}
        units |= {n: c.unit for n, c in definition.constants.items()}
        for name, unit in units.items():
            try:
                if len(unit) > _LONGEST_UNIT or not _UNIT.fullmatch(unit) or unit.count("(") != unit.count(")"):
                    raise ValueError
                registry().Unit("dimensionless" if unit == "1" else unit)
            except (
                pint.errors.UndefinedUnitError,
                pint.errors.DefinitionSyntaxError,
                ValueError,
                TypeError,
                AssertionError,
                TokenError,
            ):
                raise ModelError(f"{name} has the unknown unit {unit[:_LONGEST_UNIT]!r}") from None
        try:
            unit_of_value = self._expression.unit(units)
        except ModelError as error:
            raise ModelError(f"{error}{self._without_unit()}") from None
        if unit_of_value is not None and unit_of_value.dimensionality != registry().Unit("m").dimensionality:
            raise ModelError(f"the formula gives {unit_of_value:~P}, and not a length{self._without_unit()}")

    def _without_unit(self) -> str:
        """How a constant or coefficient of the formula that states no unit gets one; for the end of a message."""
        for key in ("constants", "coefficients", "shapes"):
            for name, entry in getattr(self._definition, key).items():
                if name in self._expression.names and "unit" not in entry.model_fields_set:
                    stated = ", ".join(f"{k}: {v}" for k, v in entry.model_dump(exclude_unset=True).items())
                    return (
                        f"; {name} states no unit and counts as a pure number: {key}: {{{name}: {{{stated}, unit: m}}}}"
                    )
        if re.search(r"(?<!\w)\d", self._definition.formula):
            return "; a number in the formula has no unit, a constant may: constants: {k: {value: 0.01, unit: m}}"
        return ""

    def _check_linear(self) -> None:
        """Linear in the coefficients: with all at zero nothing, with all doubled twice as much, with two the sum."""
        rng = np.random.default_rng(0)
        values: dict[str, Any] = {n: rng.uniform(0.5, 1.5, 16) for n in self._expression.names}
        values |= {n: c.value for n, c in self._definition.constants.items()}
        values |= {"pi": np.pi}
        names = [c.name for c in self.coefficients]
        zero = self._expression.evaluate(values | dict.fromkeys(names, 0.0))
        each = [self._expression.evaluate(values | {n: float(n == m) for n in names}) for m in names]
        mixed = self._expression.evaluate(values | {n: 2.0 + k for k, n in enumerate(names)})
        expected = sum((2.0 + k) * part for k, part in enumerate(each))
        if np.any(np.abs(zero) > 0.0):
            raise ModelError(self._constant_part(names))
        if not np.allclose(mixed, expected, rtol=1e-6, equal_nan=True):
            raise ModelError(f"the formula is not linear in {', '.join(names)}; name other unknowns under shapes")

    def _constant_part(self, names: list[str]) -> str:
        """What is wrong with a formula that is not zero where its coefficients are."""
        zero = " and ".join(names)
        text = f"with {zero} at zero the formula must be zero, but a part is not: give that part a coefficient too"
        if not self._columns:
            return text
        return f"{text} (names that are no coefficients, here {', '.join(self._columns)}, are columns of the session)"

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """Values between the limits of the nonlinear coefficient, on a logarithmic scale where both are positive."""
        if not self.shapes:
            return [()]
        low, high = self.shapes[0].low, self.shapes[0].high
        values = np.geomspace(low, high, _GRID) if low > 0 else np.linspace(low, high, _GRID)
        return [(float(v),) for v in values]

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The formula with one coefficient at one and the others at zero, for each."""
        readings = observations.readings
        n = len(readings)
        values: dict[str, Any] = {name: readings.column(name) for name in self._columns}
        values |= {"path": observations.path, "displacement": readings.displacement, "pi": np.pi}
        values |= {name: c.value for name, c in self._definition.constants.items()}
        values |= {s.name: v for s, v in zip(self.shapes, shape, strict=True)}
        names = [c.name for c in self.coefficients]
        out = [
            np.broadcast_to(self._expression.evaluate(values | {m: float(m == name) for m in names}), n)
            for name in names
        ]
        columns = np.array(out)
        if not np.isfinite(columns).all():
            raise ModelError(f"effect {self.id}: the formula has no finite value for some readings")
        if self._definition.enters == "reading":
            return columns
        return np.asarray(columns * (observations.direction @ axis_unit(self._definition.enters)))


def formula_effect(definition: dict[str, Any], source: str = "formula") -> FormulaEffect:
    """An effect from its definition; messages begin with the source.

    Raises:
        ModelError: something in it is wrong; one line that says what and where.
    """
    return FormulaEffect(checked_definition(definition, source))


def checked_definition(definition: dict[str, Any], source: str) -> _Definition:
    """A definition as a record.

    Raises:
        ModelError: a key is missing, unknown or of a wrong kind.
    """
    return validated(_Definition, definition, source, refusal=ModelError)


def read_effects(path: Path) -> list[Effect]:
    """The user's effects from a YAML file.

    Raises:
        SessionError: not such a file, or not YAML; one line with the line in the file.
        ModelError: a wrong definition; one line that says what and where.
    """
    content = load_yaml(read_text(path, _LARGEST_FILE), str(path)).value
    if not isinstance(content, dict) or set(content) != {"effects"} or not isinstance(content["effects"], list):
        raise ModelError(f"{path}: one key, effects, with a list of definitions")
    out: list[Effect] = []
    for number, entry in enumerate(content["effects"], start=1):
        if not isinstance(entry, dict):
            raise ModelError(f"{path}: effect {number} is not a definition")
        definition = checked_definition(entry, f"{path}: effect {number}")
        try:
            out.append(FormulaEffect(definition))
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from None
    return out
