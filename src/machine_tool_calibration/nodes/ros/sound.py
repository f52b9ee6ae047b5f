# SPDX-License-Identifier: Apache-2.0
"""Whether a message can mean anything at all: what no node of the graph may be handed."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Quaternion
from sensor_msgs.msg import JointState

from machine_tool_calibration.errors import CalibrationError

LAST_SECOND = 2_145_916_800  # 2038-01-01: a stamp's 32 bits end 18 days later, and what is commanded then must fit too
_LARGEST_VALUE = 1e15  # of any SI value in the graph: far beyond what occurs, and its square is still a number
_ENTRIES = 100_000  # of one array
_UNIT = 1e-3  # by which a quaternion's norm may miss 1
_ONE_BY_ONE = 50  # numbers that are looked at faster one by one

_Check = Callable[[Any], str]
"""What is wrong with a value, after where in it: `.stamp is no time`; empty if nothing is."""


def require_sound(message: Any) -> None:
    """Refuse a message that has no meaning, whatever its topic is.

    Missing values in arrays are NaN, and allowed. A CalibrationError: a stamp that is no time, a number not finite or
    absurdly large, names without values or the reverse, a rotation that is none, or more than any message holds.
    """
    if fault := _fault(message):
        raise CalibrationError(fault.lstrip(". "))


def _fault(message: Any) -> str:
    kind: Any = type(message)
    return _check_of(kind)(message)


@cache
def _check_of(kind: Any) -> _Check:
    """The check of a class of messages: only fields in which something can be wrong are looked at."""
    fields = kind.get_fields_and_field_types().items()
    checks = [(name, check) for name, type_ in fields if (check := _check_of_field(type_))]
    own = _OWN.get(kind)

    def check_all(message: Any) -> str:
        for name, check in checks:
            if fault := check(getattr(message, name)):
                return f".{name}{fault}"
        return own(message) if own is not None else ""

    return check_all


def _check_of_field(type_: str) -> _Check | None:
    """The check of a field by its type as messages tell it: `double`, `double[9]`, `sequence<std_msgs/Header>`."""
    many = re.fullmatch(r"sequence<([^,]+)(?:, \d+)?>|(.+)\[\d+\]", type_)
    single = type_ if many is None else many[1] or many[2]
    if "/" in single:
        return _fault if many is None else _messages
    if single in ("double", "float"):
        return _number if many is None else _numbers
    return None if many is None else _length


def _number(value: float) -> str:
    return "" if -_LARGEST_VALUE <= value <= _LARGEST_VALUE else f" is {value:g}"


def _numbers(values: array[float] | np.ndarray | list[float]) -> str:
    if fault := _length(values):
        return fault
    if len(values) <= _ONE_BY_ONE:
        bad = [index for index, value in enumerate(values) if value > _LARGEST_VALUE or value < -_LARGEST_VALUE]
    else:
        bad = np.flatnonzero(np.abs(np.asarray(values)) > _LARGEST_VALUE).tolist()
    return f"[{bad[0]}] is {values[bad[0]]:g}" if bad else ""


def _messages(messages: Sequence[Any]) -> str:
    if fault := _length(messages):
        return fault
    for index, message in enumerate(messages):
        if fault := _fault(message):
            return f"[{index}]{fault}"
    return ""


def _length(values: Any) -> str:
    return f" has {len(values)} entries" if len(values) > _ENTRIES else ""


def _time(value: Time) -> str:
    sec, nanosec = value.sec, value.nanosec
    return "" if 0 <= sec < LAST_SECOND and nanosec < 1_000_000_000 else f" is no time: {sec} s and {nanosec} ns"


def _duration(value: Duration) -> str:
    return "" if value.nanosec < 1_000_000_000 else f" is no duration: {value.sec} s and {value.nanosec} ns"


def _rotation(value: Quaternion) -> str:
    norm = math.hypot(value.x, value.y, value.z, value.w)
    # all zero: not given
    return f" is no rotation: its norm is {norm:g}" if norm and abs(norm - 1.0) > _UNIT else ""


def _pairs(message: JointState) -> str:
    names = len(message.name)
    if len(set(message.name)) < names:
        return " a name stands twice"
    if len(message.position) != names:
        return f" {names} names and {len(message.position)} positions"
    for field, values in (("velocities", message.velocity), ("efforts", message.effort)):
        if len(values) not in (0, names):
            return f" {names} names and {len(values)} {field}"
    return ""


_OWN: dict[Any, _Check] = {Time: _time, Duration: _duration, JointState: _pairs, Quaternion: _rotation}
"""What can be wrong with a message as a whole, by its class."""
