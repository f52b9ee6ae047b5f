# SPDX-License-Identifier: Apache-2.0
"""What a procedure's YAML file says: the session to be measured, where to go, and how to move."""

from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path as FilePath
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.catalogue import method_spec
from machine_tool_calibration.session.description import Description
from machine_tool_calibration.session.parse import describe
from machine_tool_calibration.session.record import Finite, NotNegative, Positive, Record, validated
from machine_tool_calibration.session.text import Document, load_yaml, read_text

_Count = Annotated[int, Field(ge=1, le=1000)]
_Moving = Annotated[Finite, Field(ge=1e-6, le=1e3)]  # slower nothing arrives, and faster nothing goes
_Waiting = Annotated[Positive, Field(le=86400.0)]  # a day


class Choices(Record):
    """What the user can do, beside what the procedure says already; all of that is a candidate, too."""

    # entries of `session.setups`. In each, `{first, last, count}` stands for equally spaced numbers and `{any: [...]}`
    # for one of a list: every combination is a candidate
    setups: tuple[dict[str, Any], ...] = ()
    targets: tuple[dict[str, Any], ...] = ()  # entries of `session.targets`, written in the same way
    features: tuple[str, ...] = ()  # features of the workpiece that may be left out; others are measured in any case
    repeats: tuple[_Count, ...] = ()  # how often a setup may be measured; as the session says if absent
    most_setups: _Count | None = None  # no more setups than these; as many as the session has if absent
    # no more targets, or features of those that may be left out; as many as there are if absent
    most_targets: _Count | None = None
    mounting: NotNegative = 0.0  # time that each setup takes beside moving and waiting, s
    seconds: Positive | None = None  # time for everything; what the procedure takes as it stands if absent


_SPREAD = {"first", "last", "count"}


def expanded(template: Any) -> Iterator[Any]:
    """Every entry that a template stands for, in the order in which it names them."""
    if isinstance(template, Mapping):
        if set(template) == {"any"} and isinstance(template["any"], list):
            yield from template["any"]
        elif set(template) == _SPREAD:
            # to the nanometre, so that files stay readable
            yield from np.round(np.linspace(template["first"], template["last"], int(template["count"])), 9).tolist()
        else:
            for values in product(*map(expanded, template.values())):
                yield dict(zip(template, values, strict=True))
    elif isinstance(template, list):
        yield from map(list, product(*map(expanded, template)))
    else:
        yield template


_MOST_REPEATS = 1000


_MAX_POINTS = 1_000_000
_UNNAMED = ("Spread", "tuple[float, ...]")  # names of records: no keys of the file


class Spread(Record):
    """Equally spaced positions of one axis, both ends included, m or rad."""

    first: Finite
    last: Finite
    count: Annotated[int, Field(ge=1, le=_MAX_POINTS)]

    def values(self) -> list[float]:
        """The positions; the ends are exact."""
        return [*map(float, np.linspace(self.first, self.last, self.count))]


class Path(Record):
    """The targets of one run, in their order."""

    # positions of each axis; the first axis named runs fastest
    grid: Annotated[dict[str, Spread | tuple[Finite, ...]], Field(min_length=1)] | None = None
    # or the targets one by one, each a position of the same axes
    points: Annotated[tuple[dict[str, Finite], ...], Field(min_length=1)] | None = None
    # `lines`: each line of the grid begins at the same end; `serpentine`: every second line runs back
    order: Literal["lines", "serpentine"] = "lines"
    alternate: bool = True  # every second repetition runs the path backwards
    # every run of a rotary axis turns back through the same angles, so that time and angle are distinguished
    both_ways: bool = False
    # of a rotary axis: the axis turns once for each target (`one_by_one`), or every target is read at each angle
    # (`at_every_angle`), for an instrument that finds a target again
    targets: Literal["one_by_one", "at_every_angle"] = "one_by_one"
    # directions, rad, in which a pointer holds its beam at every target, to find its centre and zero angle
    azimuth: Spread | Annotated[tuple[Finite, ...], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.grid is None) == (self.points is None):
            raise ValueError("must have either grid or points")
        if self.points is not None and not all(self.points):
            raise ValueError("points must each name an axis")
        for number, point in enumerate(self.points or ()):
            if point.keys() != (self.points or ())[0].keys():
                raise ValueError(f"points[{number}] must name the same axes as points[0]")
        size = 1
        for name, entry in (self.grid or {}).items():
            size *= entry.count if isinstance(entry, Spread) else len(entry)
            if size == 0:
                raise ValueError(f"grid.{name} has no position")
        if size > _MAX_POINTS:
            raise ValueError(f"grid has {size} targets; at most {_MAX_POINTS} are accepted")
        return self


# a step diagonal's targets follow from the session
_FROM_SESSION = Path.model_construct(
    grid=None, points=(), order="lines", alternate=False, both_ways=False, targets="one_by_one"
)


class Motion(Record):
    """How the axes move and wait."""

    speed: dict[str, _Moving] = Field(default_factory=dict)  # greatest speed of each axis, m/s or rad/s
    acceleration: dict[str, _Moving] = Field(default_factory=dict)  # greatest acceleration of each, m/s² or rad/s²
    dwell: _Waiting = 1.0  # time held at each target, s: settling and averaging must fit in
    approach: NotNegative = 0.005  # length of the short move that takes up the play before the first target, m or rad


class _File(Record):
    format: Literal["mtcal-procedure/1"]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")] = "measurement"
    session: dict[str, Any]
    path: Path | None = None
    motion: Motion = Motion()
    choices: Choices = Choices()


class Procedure(Record):
    """A measurement to be made."""

    source: str  # where it was read, for messages
    name: str  # for folders
    session: Description  # what `session.yaml` will say
    path: Path  # the targets of one run; without targets for a step diagonal, where they follow from the session
    motion: Motion  # speeds, accelerations and waiting times
    choices: Choices = Choices()  # what else could be measured, to choose the best of (`mtcal plan --optimise`)


def _require_spreads(template: Any, place: tuple[Any, ...], source: str, document: Document) -> None:
    """Refuse what stands for no equally spaced numbers in a template, by a SessionError with file, line and key."""
    if isinstance(template, Mapping):
        if set(template) == _SPREAD:
            n = len(place)
            lines = {path[n:]: line for path, line in document.lines.items() if path[:n] == place}
            validated(Spread, template, source, Document(template, lines))
            return
        parts = [*template.items()]
    elif isinstance(template, (list, tuple)):
        parts = [*enumerate(template)]
    else:
        return
    for key, part in parts:
        _require_spreads(part, (*place, key), source, document)


def read_procedure(file: FilePath) -> Procedure:
    """Read a procedure's file; a SessionError if it cannot be read, or as for `parse_procedure`."""
    return parse_procedure(read_text(file), str(file))


def parse_procedure(text: str, source: str) -> Procedure:
    """The procedure that a YAML text holds; a SessionError names file, line and key of the first defect."""
    document = load_yaml(text, source)
    if not isinstance(document.value, dict):
        raise SessionError(f"{source}: must be a mapping with the keys format, session, path and motion")
    content = validated(_File, document.value, source, document, unnamed=_UNNAMED)
    lines = {path[1:]: line for path, line in document.lines.items() if path[:1] == ("session",)}
    inner = Document({"format": "mtcal-session/1", **content.session}, lines)
    session = describe(inner.value, source, inner)
    if session.repeats > _MOST_REPEATS:
        raise SessionError(f"{source}: session.repeats is {session.repeats}; at most {_MOST_REPEATS} are planned")
    spec = method_spec(session.method)
    if content.path is None and not spec.states_runs:
        raise SessionError(f"{source}: the key 'path' is missing")
    if content.path is not None and not spec.turns_one_axis:
        for key, given in (("both_ways", content.path.both_ways), ("targets", content.path.targets != "one_by_one")):
            if given:
                raise SessionError(f"{source}: path.{key} is for the method rotary_axis; this is {session.method}")
    path = content.path or _FROM_SESSION
    motion, choices = content.motion, content.choices
    _require_spreads({"setups": choices.setups, "targets": choices.targets}, ("choices",), source, document)
    return Procedure(source=source, name=content.name, session=session, path=path, motion=motion, choices=choices)
