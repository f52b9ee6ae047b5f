# SPDX-License-Identifier: Apache-2.0
"""Formulas of a user's own effects: read by Python's parser, and worked out here; nothing of them is run as Python.

Numbers, names, + - * / ** ^, parentheses, and the functions sin, cos, tan, exp, log, sqrt, abs, sign.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pint

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError

__all__ = ["Expression", "parse", "registry"]

_MOST_CHARACTERS = 1000
_SHOWN = 80  # characters of a formula in a message
_LARGEST = 1e308
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
        """Unit of the value.

        Args:
            units: of the names; a name without a unit makes the answer unknown.

        Returns:
            The unit, or None if it cannot be known.

        Raises:
            ModelError: units do not go together: a sum of metres and seconds, an exponential of a length.
        """
        if not self.names <= set(units):
            return None
        quantity = registry().Quantity
        one = {n: quantity(1.0, "" if units[n] == "1" else units[n]).to_base_units() for n in self.names}
        try:
            with np.errstate(all="ignore"):
                value = _evaluate(self.node, one)
        except pint.DimensionalityError as error:
            found, needed = (unit or "dimensionless" for unit in (error.units1, error.units2))
            raise ModelError(f"formula {self.text!r}: a quantity in {found} where one in {needed} must be") from None
        return quantity(value).units


def parse(text: str) -> Expression:
    """Read a formula.

    Raises:
        ModelError: not a formula, with the place where it stops making sense.
    """
    if len(text) > _MOST_CHARACTERS:
        raise ModelError(f"formula of {len(text)} characters; at most {_MOST_CHARACTERS} are read")
    shown = repr(text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "...")
    plain = _NAME.sub(r"\g<0>_", re.sub(r"\s", " ", text.replace("^", "**"))).strip()
    try:
        if (other := _OTHER.search(plain)) is not None:
            raise SyntaxError("", ("", 1, other.start() + 1, plain))
        expression = Expression(text, ast.parse(plain, mode="eval").body)
        if _depth(expression.node) > _MOST_DEPTH:
            raise RecursionError
        expression.evaluate(dict.fromkeys(expression.names, 1.0))
    except SyntaxError as error:
        place = max(error.offset or 1, 1)
        place -= len(_NAME.findall(plain[: place - 1]))
        raise ModelError(f"formula {shown}: not understood at character {place}") from None
    except (RecursionError, MemoryError):
        raise ModelError(f"formula {shown}: nested too deeply, or too long a sum") from None
    return expression


def _depth(node: ast.AST) -> int:
    return 1 + max(map(_depth, ast.iter_child_nodes(node)), default=0)


def _evaluate(node: ast.expr, values: Mapping[str, Any]) -> Any:
    """The value, of numbers or of quantities with units; SyntaxError where something of Python's is no formula."""
    match node:
        case ast.Constant(value=int() | float() as number) if number < _LARGEST:
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
