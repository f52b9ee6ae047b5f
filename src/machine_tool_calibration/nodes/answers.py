# SPDX-License-Identifier: Apache-2.0
"""What an instrument answers (`instrument/datum`, `instrument/capture`), as events of the procedure."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from typing import Any

from machine_tool_calibration.nodes.ros.sound import LAST_SECOND
from machine_tool_calibration.procedure.events import Captured, CaptureFailed, DatumSet

__all__ = ["event_of"]


def event_of(
    token: int, success: bool, message: str, *, is_datum: bool, sensed: Callable[[int], Mapping[str, float]]
) -> Captured | CaptureFailed | DatumSet:
    """The event of an answer; one that makes no sense is a failure that says so.

    Args:
        token: of the request.
        success: whether the instrument did what was asked.
        message: its JSON document.
        is_datum: whether a datum was asked for, not a reading.
        sensed: the environment by column at a time, ns.
    """
    try:
        document = json.loads(message)
        if not success:
            return CaptureFailed(token, document["kind"], document["reason"])
        datum, inputs = str(document["datum"]), {name: _time(value) for name, value in document["inputs"].items()}
        if is_datum:
            return DatumSet(token, datum, _time(document["start"]), inputs)
        stamp, displacement = _time(document["stamp"]), float(document["displacement"])
        if math.isinf(displacement):
            raise ValueError("a displacement without end")
        own = {name: float(value) for name, value in document["environment"].items()}
        return Captured(
            token=token,
            stamp=stamp,
            start=_time(document["start"]),
            end=_time(document["end"]),
            displacement=displacement,
            datum=datum,
            columns={**sensed(stamp), **own},
            inputs=inputs,
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        reason = f"not an answer of an instrument: {message[:80]!r} ({type(error).__name__})"
        return CaptureFailed(token, "other", reason)


def _time(value: Any) -> int:
    if not isinstance(value, int) or not 0 <= value < LAST_SECOND * 1_000_000_000:
        raise ValueError("not a time in ns")
    return value
