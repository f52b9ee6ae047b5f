"""Whether a message can mean anything at all: what no node of the graph may be handed."""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Quaternion
from sensor_msgs.msg import JointState

from machine_tool_calibration.errors import CalibrationError

__all__ = ["LAST_SECOND", "require_sound"]

LAST_SECOND = 2_145_916_800  # 2038-01-01: a stamp's 32 bits end 18 days later, and what is commanded then must fit too
_LARGEST = 1e15  # of any SI value in the graph: far beyond what occurs, and its square is still a number
_ENTRIES = 100_000  # of one array
_UNIT = 1e-3  # by which a quaternion's norm may miss 1


def require_sound(message: Any) -> None:
    """Refuse a message that has no meaning, whatever its topic is.

    Missing values in arrays are NaN, and allowed.

    Raises:
        CalibrationError: a stamp that is no time, a number that is not finite or absurdly large, names without values
            or values without names, a rotation that is none, or far more than any message of the graph holds.
    """
    _require(message, "")


def _require(value: Any, where: str) -> None:
    match value:
        case float():
            if not abs(value) <= _LARGEST:
                raise CalibrationError(f"{where} is {value:g}")
        case bool() | int() | bytes() | str():
            pass
        case Time():
            if not 0 <= value.sec < LAST_SECOND or value.nanosec > 999_999_999:
                raise CalibrationError(f"{where} is no time: {value.sec} s and {value.nanosec} ns")
        case Duration():
            if value.nanosec > 999_999_999:
                raise CalibrationError(f"{where} is no duration: {value.sec} s and {value.nanosec} ns")
        case array() | np.ndarray() | list():
            _require_all(value, where)
        case _:
            for name in _fields(type(value)):
                _require(getattr(value, name), f"{where}.{name}" if where else name)
            if isinstance(value, JointState):
                _require_pairs(value)
            elif isinstance(value, Quaternion):
                norm = math.hypot(value.x, value.y, value.z, value.w)
                if norm and abs(norm - 1.0) > _UNIT:  # all zero: not given
                    raise CalibrationError(f"{where} is no rotation: its norm is {norm:g}")


def _require_all(values: Sequence[Any], where: str) -> None:
    if len(values) > _ENTRIES:
        raise CalibrationError(f"{where} has {len(values)} entries")
    if isinstance(values, list):
        for index, entry in enumerate(values):
            _require(entry, f"{where}[{index}]")
    else:
        numbers = np.asarray(values)
        bad = np.flatnonzero(np.abs(numbers) > _LARGEST)
        if len(bad):
            raise CalibrationError(f"{where}[{bad[0]}] is {numbers[bad[0]]:g}")


def _require_pairs(message: JointState) -> None:
    names = len(message.name)
    if len(set(message.name)) < names:
        raise CalibrationError("a name stands twice")
    if len(message.position) != names:
        raise CalibrationError(f"{names} names and {len(message.position)} positions")
    for field, values in (("velocities", message.velocity), ("efforts", message.effort)):
        if len(values) not in (0, names):
            raise CalibrationError(f"{names} names and {len(values)} {field}")


@cache
def _fields(kind: type) -> tuple[str, ...]:
    return tuple(kind.get_fields_and_field_types())  # type: ignore[attr-defined]
