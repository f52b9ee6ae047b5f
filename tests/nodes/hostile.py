# SPDX-License-Identifier: Apache-2.0
"""Messages as no node of ours sends them: each value of the pages' examples replaced by one that is wrong or absurd."""

import copy
from array import array
from collections.abc import Iterator
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time

from .pages import message_of, rows, sections

FLOATS = (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 5e-324, -1.0, 1e18)
TEXTS = ("", "nan", "soon", "-1", "1e308", "9" * 40, "{", "[" * 3000, "\u2028\ufeff", "A" * 100_000)
TIMES = ((0, 4_000_000_000), (-1, 0), (-(2**31), 0), (2**31 - 1, 999_999_999), (0, 1_000_000_000))


def examples(topic: str) -> list[Any]:
    """Messages of a topic as the pages show them."""
    row = rows()[topic]
    return [message_of(row.type, example) for example in sections()[topic][0].examples]


def mutated(message: Any) -> Iterator[tuple[str, Any]]:
    """Copies of a message, each with one value spoilt, and which."""
    for name in message.get_fields_and_field_types():
        for label, value in _spoilt(getattr(message, name)):
            made = copy.deepcopy(message)
            try:
                setattr(made, name, value)
            except (AssertionError, ValueError):
                continue  # what Python does not let be sent is no message
            yield f"{name}{label}", made


def _spoilt(value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Time | Duration):
        for sec, nanosec in TIMES:
            yield f" = {sec} s {nanosec} ns", type(value)(sec=sec, nanosec=nanosec)
    elif hasattr(value, "get_fields_and_field_types"):
        for label, made in mutated(value):
            yield f".{label}", made
    elif isinstance(value, str):
        yield from ((f" = {text[:20]!r}", text) for text in TEXTS)
    elif isinstance(value, float):
        yield from ((f" = {number}", number) for number in FLOATS)
    elif isinstance(value, list | tuple | array | np.ndarray):
        yield from _spoilt_list(list(value))


def _spoilt_list(entries: list[Any]) -> Iterator[tuple[str, Any]]:
    yield "[]", []
    if not entries:
        return
    yield "[:-1]", entries[:-1]
    yield " twice", entries + entries
    yield " * 1000", entries * 1000
    for index, entry in enumerate(entries):
        for label, made in _spoilt(entry):
            yield f"[{index}]{label}", [*entries[:index], made, *entries[index + 1 :]]
