# SPDX-License-Identifier: Apache-2.0
"""Formulas of a user's own effects: parsed by a small grammar, never evaluated as Python.

Numbers, names, + - * / ** ^, parentheses, and the functions sin, cos, tan, exp, log, sqrt, abs, sign.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pint
import pyparsing as pp

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import ModelError

__all__ = ["Expression", "parse", "registry"]

_MOST_CHARACTERS = 1000
_SHOWN = 80  # characters of a formula in a message
_MOST_DEPTH = 250  # operations inside one another; evaluating them takes as many frames

_FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "exp": np.exp, "log": np.log,
    "sqrt": np.sqrt, "abs": np.abs, "sign": np.sign,
}  # fmt: skip
_OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "**": operator.pow,
}  # fmt: skip


@dataclass(frozen=True)
class _Number:
    value: float


@dataclass(frozen=True)
class _Name:
    name: str


@dataclass(frozen=True)
class _Call:
    function: str
    argument: _Node


@dataclass(frozen=True)
class _Operation:
    symbol: str
    left: _Node
    right: _Node


_Node = _Number | _Name | _Call | _Operation


@cache
def registry() -> pint.UnitRegistry[Any]:
    """Units; angles count as dimensionless."""
    return pint.UnitRegistry(cache_folder=None)


@dataclass(frozen=True)
class Expression:
    """A parsed formula."""

    text: str
    node: _Node

    @property
    def names(self) -> frozenset[str]:
        """All names in it."""
        return frozenset(_names(self.node))

    def evaluate(self, values: Mapping[str, Array | float]) -> Array:
        """The formula's value for arrays of equal length."""
        with np.errstate(all="ignore"):
            return np.asarray(_evaluate(self.node, values), dtype=float)

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
        return _unit(self.node, units, self.text)


def parse(text: str) -> Expression:
    """Read a formula.

    Raises:
        ModelError: not a formula, with the place where it stops making sense.
    """
    if len(text) > _MOST_CHARACTERS:
        raise ModelError(f"formula of {len(text)} characters; at most {_MOST_CHARACTERS} are read")
    try:
        node = _grammar().parse_string(text.replace("^", "**"), parse_all=True)[0]
        too_deep = _depth(node) > _MOST_DEPTH
    except pp.ParseException as error:
        raise ModelError(f"formula {_shown(text)}: not understood at character {error.loc + 1}") from None
    except RecursionError:
        too_deep = True
    if too_deep:
        raise ModelError(f"formula {_shown(text)}: nested too deeply, or too long a sum")
    return Expression(text, node)


def _shown(text: str) -> str:
    return repr(text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "...")


def _depth(node: _Node) -> int:
    if isinstance(node, _Call):
        return 1 + _depth(node.argument)
    if isinstance(node, _Operation):
        return 1 + max(_depth(node.left), _depth(node.right))
    return 1


@cache
def _grammar() -> pp.ParserElement:
    number = pp.common.fnumber.copy().set_parse_action(lambda t: _Number(float(t[0])))
    identifier = pp.Word(pp.alphas + "_", pp.alphanums + "_")
    name = identifier.copy().set_parse_action(lambda t: _Name(t[0]))
    expression = pp.Forward()
    call = (
        pp.one_of(list(_FUNCTIONS), as_keyword=True) + pp.Suppress("(") + expression + pp.Suppress(")")
    ).set_parse_action(lambda t: _Call(t[0], t[1]))
    atom = call | number | name | pp.Suppress("(") + expression + pp.Suppress(")")
    unary = pp.Forward()
    power = atom + pp.Optional(pp.Suppress("**") + unary)
    power = power.set_parse_action(lambda t: _Operation("**", t[0], t[1]) if len(t) == 2 else t[0])
    minus = (pp.Suppress("-") + unary).set_parse_action(lambda t: _Operation("*", _Number(-1.0), t[0]))
    unary <<= minus | power
    product = _chain(unary, "* /")
    expression <<= _chain(product, "+ -")
    return expression


def _chain(operand: pp.ParserElement, symbols: str) -> pp.ParserElement:
    sign = pp.one_of(symbols)
    if "*" in symbols:
        sign = ~pp.Literal("**") + sign

    def fold(tokens: pp.ParseResults) -> _Node:
        items = list(tokens)
        node: _Node = items[0]
        for symbol, right in zip(items[1::2], items[2::2], strict=True):
            node = _Operation(symbol, node, right)
        return node

    return (operand + pp.ZeroOrMore(sign + operand)).set_parse_action(fold)


def _names(node: _Node) -> set[str]:
    if isinstance(node, _Name):
        return {node.name}
    if isinstance(node, _Call):
        return _names(node.argument)
    if isinstance(node, _Operation):
        return _names(node.left) | _names(node.right)
    return set()


def _evaluate(node: _Node, values: Mapping[str, Array | float]) -> Any:
    if isinstance(node, _Number):
        return node.value
    if isinstance(node, _Name):
        return np.asarray(values[node.name], dtype=float)
    if isinstance(node, _Call):
        return _FUNCTIONS[node.function](_evaluate(node.argument, values))
    return _OPERATORS[node.symbol](
        np.asarray(_evaluate(node.left, values), dtype=float), np.asarray(_evaluate(node.right, values), dtype=float)
    )


def _unit(node: _Node, units: Mapping[str, str], text: str) -> Any:
    one = registry().Unit("dimensionless")
    if isinstance(node, _Number):
        return one
    if isinstance(node, _Name):
        return registry().Unit(units[node.name] if units[node.name] != "1" else "dimensionless")
    if isinstance(node, _Call):
        inner = _unit(node.argument, units, text)
        if node.function == "sign":
            return one
        if node.function == "abs":
            return inner
        if node.function == "sqrt":
            return inner**0.5
        if not inner.dimensionless:
            raise ModelError(f"formula {text!r}: {node.function} of a quantity in {inner}")
        return one
    left, right = _unit(node.left, units, text), _unit(node.right, units, text)
    if node.symbol == "*":
        return left * right
    if node.symbol == "/":
        return left / right
    if node.symbol == "**":
        if not isinstance(node.right, _Number):
            if not (left.dimensionless and right.dimensionless):
                raise ModelError(f"formula {text!r}: a power whose exponent is not a number needs pure numbers")
            return one
        return left**node.right.value
    # A bare number in a sum has the unit of what it is added to: temperature_x - 20.
    if isinstance(node.left, _Number) or isinstance(node.right, _Number):
        return right if isinstance(node.left, _Number) else left
    if left.dimensionality != right.dimensionality:
        raise ModelError(f"formula {text!r}: {left} and {right} cannot be added")
    return left
