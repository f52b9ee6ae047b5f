# SPDX-License-Identifier: Apache-2.0
"""A user's own effect by formula, from a YAML file or the command line.

effects:
- id: creep_y
title: creep of the Y slide after a move
enters: y                  # x, y, z: displacement of that axis; ECX, EBC …: that error motion; reading: the reading
formula: b * dir_y * exp(-time / tau)
coefficients: {b: {unit: m, low: -1.0e-5, high: 1.0e-5}}
shapes: {tau: {unit: s, low: 10, high: 1.0e4}}
columns: {my_column: K}     # units of columns of your own, if they shall be checked
constants: {k0: {value: 2.5, unit: 1/s}}
"""

from __future__ import annotations

import ast
import operator
import re
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from tokenize import TokenError
from typing import Annotated, Any

import numpy as np
import pint
from pint.errors import DefinitionSyntaxError, UndefinedUnitError
from pydantic import Field, field_validator, model_validator

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient, Effect, Shape, axis_unit
from machine_tool_calibration.effects.error_motion import sensed_motion
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.error_motions import ERROR_MOTION, parse_motion
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.record import Record, place_in, validated
from machine_tool_calibration.session.text import read_yaml
from machine_tool_calibration.session.values import Finite

_MOST_CHARACTERS = 1000
_CHARACTERS_SHOWN = 80  # characters of a formula in a message
_LARGEST_NUMBER = 1e308  # below infinity
_LARGEST_VALUE = 1e100  # of which the square is a number, too
_MOST_DEPTH = 250  # operations inside one another; working them out takes as many frames

_FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "exp": np.exp, "log": np.log,
    "sqrt": np.sqrt, "abs": np.abs, "sign": np.sign,
}  # fmt: skip
_OPERATORS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: lambda a, b: _like(a, b) + _like(b, a), ast.Sub: lambda a, b: _like(a, b) - _like(b, a),
    ast.Mult: operator.mul, ast.Div: operator.truediv, ast.Pow: operator.pow,
}  # fmt: skip
_OTHER = re.compile(r"[^A-Za-z0-9_+\-*/().\s]")
_NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*")


def _like(value: Any, other: Any) -> Any:
    """A bare number in a sum has the unit of what it is added to: temperature_x - 20."""
    return value * other.units if hasattr(other, "units") and not hasattr(value, "units") else value


@cache
def registry() -> pint.UnitRegistry[Any]:
    """Units; angles count as dimensionless."""
    return pint.UnitRegistry(cache_folder=None)


@dataclass(frozen=True)
class Expression:
    """A parsed formula; its tree has every name with a letter more, so that none is a word of Python's (lambda)."""

    text: str
    node: ast.expr

    @property
    def names(self) -> frozenset[str]:
        """All names in it, but for those of functions."""
        called = {id(node.func) for node in ast.walk(self.node) if isinstance(node, ast.Call)}
        named = (node for node in ast.walk(self.node) if isinstance(node, ast.Name) and id(node) not in called)
        return frozenset(node.id[:-1] for node in named)

    def evaluate(self, values: Mapping[str, Array | float]) -> Array:
        """The formula's value for arrays of equal length."""
        with np.errstate(all="ignore"):
            return np.asarray(_evaluate(self.node, {n: np.asarray(values[n], float) for n in self.names}), dtype=float)

    def unit(self, units: Mapping[str, str]) -> Any:
        """Unit of the value by those of the names; None where it cannot be known, as one of them has none.

        A ModelError if units do not go together: a sum of metres and seconds, an exponential of a length.
        """
        if not self.names <= set(units):
            return None
        quantity = registry().Quantity
        unity = np.float64(1.0)  # of which a quotient by zero is no error
        one = {n: quantity(unity, "" if units[n] == "1" else units[n]).to_base_units() for n in self.names}
        try:
            with np.errstate(all="ignore"):
                value = _evaluate(self.node, one)
        except pint.DimensionalityError as error:
            found, needed = (unit or "dimensionless" for unit in (error.units1, error.units2))
            raise ModelError(f"formula {self.text!r}: a quantity in {found} where one in {needed} must be") from None
        return quantity(value).units


def parse(text: str) -> Expression:
    """Read a formula; a ModelError: not a formula, with the place where it stops making sense."""
    if len(text) > _MOST_CHARACTERS:
        raise ModelError(f"formula of {len(text)} characters; at most {_MOST_CHARACTERS} are read")
    shown = repr(text if len(text) <= _CHARACTERS_SHOWN else text[: _CHARACTERS_SHOWN - 3] + "...")
    plain = _NAME.sub(r"\g<0>_", re.sub(r"\s", " ", text.replace("^", "**"))).strip()
    try:
        if (other := _OTHER.search(plain)) is not None:
            raise SyntaxError("", ("", 1, other.start() + 1, plain))
        expression = Expression(text, ast.parse(plain, mode="eval").body)
        if _depth(expression.node) > _MOST_DEPTH:
            raise RecursionError
        expression.evaluate(dict.fromkeys(expression.names, 1.0))
    except SyntaxError as error:
        place = max(error.offset or len(plain) + 1, 1)  # 0 where something is missing at the end
        place -= len(_NAME.findall(plain[: place - 1]))
        known = f"numbers, names, + - * / ** ^ ( ) and {', '.join(sorted(_FUNCTIONS))} are"
        raise ModelError(f"formula {shown}: not understood at character {place}; {known}") from None
    except (RecursionError, MemoryError):
        raise ModelError(f"formula {shown}: nested too deeply, or too long a sum") from None
    return expression


def _depth(node: ast.AST) -> int:
    return 1 + max(map(_depth, ast.iter_child_nodes(node)), default=0)


def _evaluate(node: ast.expr, values: Mapping[str, Any]) -> Any:
    """The value, of numbers or of quantities with units; SyntaxError where something of Python's is no formula."""
    match node:
        case ast.Constant(value=int() | float() as number) if number < _LARGEST_NUMBER:
            return np.float64(number)
        case ast.Name(id=name):
            return values[name[:-1]]
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=operand):
            return -_evaluate(operand, values) if isinstance(sign, ast.USub) else _evaluate(operand, values)
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name[:-1] in _FUNCTIONS:
            return _FUNCTIONS[name[:-1]](_evaluate(argument, values))
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
            return _OPERATORS[type(op)](_evaluate(left, values), _evaluate(right, values))
    raise SyntaxError("", ("", 1, node.col_offset + 1, ""))


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
# Values of a nonlinear coefficient at first, and at most; cosine of the columns of two of them that are alike.
_GRID, _MOST_GRID, _ALIKE = 12, 1000, 0.9
_SAMPLE, _ROUNDED = 2000, 1e-9  # readings by which columns are compared; length over the largest that is rounding
_LARGEST_FILE = 1 << 20
_ROUNDING = 1e-9  # of a factor between units


def _apart(one: Array, other: Array, least: Array) -> bool:
    """Whether some column of a coefficient is not alike at two values; columns of hardly any length are no others."""
    lengths = [np.linalg.norm(columns, axis=1) for columns in (one, other)]
    there = (lengths[0] > least) & (lengths[1] > least)
    cosine = np.abs(np.sum(one * other, axis=1))[there] / (lengths[0] * lengths[1])[there]
    return bool((cosine < _ALIKE).any())


def _in_si(name: str, unit: str) -> tuple[float, str]:
    """What a number in the unit of something by this name is multiplied by, and the unit that it then has.

    Temperatures in degrees Celsius are kelvin: only differences mean something. A ModelError: not a unit.
    """
    if unit == "1":
        return 1.0, unit
    try:
        if len(unit) > _LONGEST_UNIT or not _UNIT.fullmatch(unit) or unit.count("(") != unit.count(")"):
            raise ValueError
        one, two = (registry().Quantity(value, unit).to_base_units() for value in (1.0, 2.0))
    except (UndefinedUnitError, DefinitionSyntaxError, ValueError, TypeError, AssertionError, TokenError):
        raise ModelError(f"{name} has the unknown unit {unit[:_LONGEST_UNIT]!r}") from None
    factor = float(two.magnitude - one.magnitude)
    if abs(factor - 1.0) > _ROUNDING and abs(one.magnitude - factor) > _ROUNDING * factor:
        raise ModelError(f"{name} is in {unit}, which has another zero than degC: write it in that")
    return (1.0, unit) if abs(factor - 1.0) < _ROUNDING else (factor, f"{one.units:~C}")


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

    def in_si(self, name: str) -> tuple[str, float, float]:
        """Its unit and range in SI; see `_in_si`."""
        factor, unit = _in_si(name, self.unit)
        return unit, self.low * factor, self.high * factor


class _Constant(Record):
    value: Finite
    unit: str = "1"


class _Definition(Record):
    id: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,60}$")]
    title: str = ""
    enters: str
    formula: str
    coefficients: Annotated[dict[str, _Unknown], Field(min_length=1)]
    shapes: Annotated[dict[str, _Unknown], Field(max_length=1)] = Field(default_factory=dict)
    columns: dict[str, str] = Field(default_factory=dict)
    constants: dict[str, _Constant] = Field(default_factory=dict)
    source: str = "the user's own formula"

    @field_validator("enters")
    @classmethod
    def _known(cls, value: str) -> str:
        if value not in ("x", "y", "z", "reading") and not re.fullmatch(ERROR_MOTION, value):
            raise ValueError("must be x, y, z, reading, or an error motion by ISO 230-1 such as ECX")
        return value


class FormulaEffect(Effect):
    """An effect of the user's own: linear in its coefficients, with at most one nonlinear one."""

    def __init__(self, definition: Mapping[str, Any], source: str = "formula") -> None:
        """Check a definition; messages begin with the source, or with the effect's id.

        A ModelError in one line: a key is missing, unknown or of a wrong kind, or the formula cannot be parsed, is not
        linear in its coefficients, or its units do not fit.
        """
        checked = validated(_Definition, definition, source, refusal=ModelError)
        try:
            self._build(checked)
        except ModelError as error:
            raise ModelError(f"effect {checked.id}: {error}") from None

    def _build(self, definition: _Definition) -> None:
        self._definition = definition
        self.definition = definition.model_dump(mode="json", exclude_defaults=True)
        self._expression = parse(definition.formula)
        self.id = definition.id
        self.title = definition.title or definition.id
        self.formula = f"{'e_' if definition.enters in 'xyz' else ''}{definition.enters} = {definition.formula}"
        self._motion = parse_motion(definition.enters) if definition.enters.isupper() else None
        self.chain = self._motion.axis if self._motion is not None and self._motion.axis in "XYZ" else ""
        self.source = definition.source
        self.kind = "reading" if definition.enters == "reading" else "position"
        self.coefficients = tuple(Coefficient(n, *u.in_si(n), u.meaning) for n, u in definition.coefficients.items())
        self.shapes = tuple(Shape(n, *u.in_si(n), meaning=u.meaning) for n, u in definition.shapes.items())
        self._constants = {n: c.value * _in_si(n, c.unit)[0] for n, c in definition.constants.items()} | {"pi": np.pi}
        self._units = {n: _in_si(n, unit)[0] for n, unit in definition.columns.items()}
        for name, factor in self._units.items():
            if factor != 1.0 and name in _UNITS:
                raise ModelError(f"{name} is in {_UNITS[name]} in every session, not in {definition.columns[name]}")
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
        try:
            unit_of_value = self._expression.unit(units)
        except ModelError as error:
            raise ModelError(f"{error}{self._without_unit()}") from None
        turns = self._motion is not None and self._motion.is_rotation
        meant, what = ("rad", "an angle") if turns else ("m", "a length")
        if unit_of_value is not None and unit_of_value.dimensionality != registry().Unit(meant).dimensionality:
            gives = f"{unit_of_value:~P}" or "a plain number"
            raise ModelError(f"the formula gives {gives}, and not {what}{self._without_unit()}")

    def _without_unit(self) -> str:
        """How a constant or coefficient of the formula that states no unit gets one; for the end of a message."""
        for key in ("constants", "coefficients", "shapes"):
            for name, entry in getattr(self._definition, key).items():
                if name in self._expression.names and "unit" not in entry.model_fields_set:
                    stated = ", ".join(f"{k}: {v}" for k, v in entry.model_dump(exclude_unset=True).items())
                    said = f"{key}: {{{name}: {{{stated}, unit: m}}}}"
                    return f"; {name} states no unit and counts as a pure number: {said}"
        if re.search(r"(?<!\w)\d", self._definition.formula):
            return "; a number in the formula has no unit, a constant may: constants: {k: {value: 0.01, unit: m}}"
        return ""

    def _check_linear(self) -> None:
        """Linear in the coefficients: with all at zero nothing, with all doubled twice as much, with two the sum."""
        rng = np.random.default_rng(0)
        values: dict[str, Any] = {n: rng.uniform(0.5, 1.5, 16) for n in self._expression.names}
        values |= self._constants
        names = [c.name for c in self.coefficients]
        zero = self._expression.evaluate(values | dict.fromkeys(names, 0.0))
        each = [self._expression.evaluate(values | {n: float(n == m) for n in names}) for m in names]
        mixed = self._expression.evaluate(values | {n: 2.0 + k for k, n in enumerate(names)})
        expected = sum((2.0 + k) * part for k, part in enumerate(each))
        if np.any(np.abs(zero) > 0.0):
            raise ModelError(self._constant_part(names))
        if not np.allclose(mixed, expected, rtol=1e-6, equal_nan=True):
            raise ModelError(f"the formula is not linear in {', '.join(names)}; name other unknowns under shapes")
        # Of any size and sign: what begins late, or far out, is zero elsewhere, and what has signs nearly everywhere.
        anywhere = {n: rng.choice([-1, 1], 400) * 10 ** rng.uniform(-6, 6, 400) for n in values} | self._constants
        for name in names:
            column = self._expression.evaluate(anywhere | {n: float(n == name) for n in names})
            if not np.any(np.nan_to_num(column)) and "sign" not in self._expression.text:
                raise ModelError(f"the formula is zero whatever {name} is")

    def _constant_part(self, names: list[str]) -> str:
        """What is wrong with a formula that is not zero where its coefficients are."""
        zero = " and ".join(names)
        text = f"with {zero} at zero the formula must be zero, but a part is not: give that part a coefficient too"
        if not self._columns:
            return text
        return f"{text} (names that are no coefficients, here {', '.join(self._columns)}, are columns of the session)"

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """Values between the limits of the nonlinear coefficient, on a logarithmic scale where both are positive.

        More of them where the columns of neighbours and of what is between them are not alike, as of a wave.
        """
        if not self.shapes:
            return [()]
        low, high = self.shapes[0].low, self.shapes[0].high
        spaced = np.geomspace if low > 0 else np.linspace
        known = {float(value): self._sampled(observations, float(value)) for value in spaced(low, high, _GRID)}
        # Below that it is rounding, such as of the sine of a wave with a node at every place.
        least = _ROUNDED * np.max([np.linalg.norm(columns, axis=1) for columns in known.values()], axis=0)
        between = deque(pairwise(known))
        while between and len(known) < _MOST_GRID:
            one, other = between.popleft()
            middle = float(spaced(one, other, 3)[1])
            columns = self._sampled(observations, middle)
            if middle not in known and any(_apart(columns, known[end], least) for end in (one, other)):
                known[middle] = columns
                between += [(one, middle), (middle, other)]
        return [(value,) for value in sorted(known)]

    def _sampled(self, observations: Observations, value: float) -> Array:
        """(k, n) columns at a value, of a sample of the readings where these are many."""
        n = len(observations)
        some = np.random.default_rng(0).choice(n, _SAMPLE, replace=False) if n > _SAMPLE else slice(None)
        return np.asarray(np.nan_to_num(self.columns(observations, (value,)))[:, some])

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """The formula with one coefficient at one and the others at zero, for each."""
        readings = observations.readings
        n = len(readings)
        values: dict[str, Any] = {name: readings.column(name) * self._units.get(name, 1.0) for name in self._columns}
        values |= {"path": observations.path, "displacement": readings.displacement} | self._constants
        values |= {s.name: v for s, v in zip(self.shapes, shape, strict=True)}
        names = [c.name for c in self.coefficients]
        each = (self._expression.evaluate(values | {m: float(m == name) for m in names}) for name in names)
        columns = np.array([np.broadcast_to(one, n) for one in each])
        if not (np.abs(columns) < _LARGEST_VALUE).all():
            raise ModelError(f"effect {self.id}: the formula has no finite value for some readings")
        if self._definition.enters == "reading":
            return columns
        if self._motion is not None:
            return np.asarray(columns * sensed_motion(observations, self._motion))
        return np.asarray(columns * (observations.direction @ axis_unit(self._definition.enters)))


def read_effects(path: Path) -> list[Effect]:
    """The user's effects from a YAML file.

    A SessionError: not such a file, or not YAML; one line with the line in the file; a ModelError if a wrong
    definition; one line that says what and where.
    """
    document = read_yaml(path, _LARGEST_FILE)
    content = document.value
    if not isinstance(content, dict) or set(content) != {"effects"} or not isinstance(content["effects"], list):
        raise ModelError(f"{path}: one key, effects, with a list of definitions")
    out: list[Effect] = []
    for number, entry in enumerate(content["effects"], start=1):
        place = ("effects", number - 1)
        if not isinstance(entry, dict):
            raise ModelError(f"{place_in(str(path), document, place)}: effect {number} is not a definition")
        try:
            out.append(FormulaEffect(entry, f"effect {number}"))
        except ModelError as error:
            raise ModelError(f"{place_in(str(path), document, place)}: {error}") from None
    return out
