# SPDX-License-Identifier: Apache-2.0
"""What else a procedure could measure: candidates for its setups and targets, and what it may cost."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from machine_tool_calibration.session.record import NotNegative, Positive, Record

__all__ = ["Choices", "expanded"]

_Count = Annotated[int, Field(ge=1, le=1000)]


class Choices(Record):
    """What the user can do, beside what the procedure says already; all of that is a candidate, too.

    Attributes:
        setups: entries of `session.setups`. In each, `{first, last, count}` stands for equally spaced numbers and
            `{any: [...]}` for one of a list: every combination is a candidate.
        targets: entries of `session.targets`, written in the same way.
        features: features of the workpiece that may be left out; all others are measured in any case.
        repeats: how often a setup may be measured; as the session says if absent.
        most_setups: no more setups than these; as many as the session has if absent.
        most_targets: no more targets, or features of those that may be left out; as many as there are if absent.
        mounting: time that each setup takes beside moving and waiting, s.
        seconds: time for everything; what the procedure takes as it stands if absent.
    """

    setups: tuple[dict[str, Any], ...] = ()
    targets: tuple[dict[str, Any], ...] = ()
    features: tuple[str, ...] = ()
    repeats: tuple[_Count, ...] = ()
    most_setups: _Count | None = None
    most_targets: _Count | None = None
    mounting: NotNegative = 0.0
    seconds: Positive | None = None


def expanded(template: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Every entry that a template stands for, in the order in which it names them."""
    places = list(_alternatives(template, ()))
    for values in product(*(options for _, options in places)):
        chosen = dict(zip((path for path, _ in places), values, strict=True))
        yield _filled(template, (), chosen)


_Place = tuple[str | int, ...]


def _alternatives(value: Any, path: _Place) -> Iterator[tuple[_Place, list[Any]]]:
    if isinstance(value, Mapping):
        if set(value) == {"any"} and isinstance(value["any"], list):
            yield path, value["any"]
        elif set(value) == {"first", "last", "count"}:
            # to the nanometre, so that files stay readable
            yield path, np.round(np.linspace(value["first"], value["last"], int(value["count"])), 9).tolist()
        else:
            for key, inner in value.items():
                yield from _alternatives(inner, (*path, key))
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from _alternatives(inner, (*path, number))


def _filled(value: Any, path: _Place, chosen: Mapping[_Place, Any]) -> Any:
    if path in chosen:
        return chosen[path]
    if isinstance(value, Mapping):
        return {key: _filled(inner, (*path, key), chosen) for key, inner in value.items()}
    if isinstance(value, list):
        return [_filled(inner, (*path, number), chosen) for number, inner in enumerate(value)]
    return value
