# SPDX-License-Identifier: Apache-2.0
"""Readings by ISO 230-2: deviations at target positions, approached in runs up and down, as direct readings."""

import re
from collections.abc import Collection

import numpy as np
from scipy.ndimage import median_filter

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, first_true, groups, occurrence
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.importing.columns import Columns, Rows
from machine_tool_calibration.importing.mapping import Run
from machine_tool_calibration.importing.points import check_deviations
from machine_tool_calibration.importing.text_table import TextTable
from machine_tool_calibration.methods.ball_bar.circle import places
from machine_tool_calibration.session.description import CircleSetup
from machine_tool_calibration.session.record import validated

_UP = ("up", "+", "+1", "1", "↑", "forward", "fwd", "positive", "pos", "auf", "vor")
_DOWN = ("down", "-", "-1", "↓", "reverse", "rev", "backward", "negative", "neg", "ab", "zurück")
_NAME = re.compile(
    r"(?:run|lauf|r|j)?\s*(?P<before>\d+)?\s*[\s_./:(]*(?P<sense>[^\d\s_./:()\[\]]+)[\s_./:)]*(?P<after>\d+)?"
    r"\s*(?:\[[^\]]*\])?",
    re.IGNORECASE,
)


def positioning_rows(columns: Columns, name: str) -> Rows:
    """A reading for each deviation: runs in their order, each along the way that it went; `name` is the setup."""
    mapping = columns.mapping
    if mapping.axis is None:
        raise SessionError(f"{columns.table.source}: which axis was moved is not said, as in --axis x")
    # Only where every reading has its row is there a column of directions.
    if mapping.layout == "wide" and not columns.has("direction"):
        position, run, up, deviation, row = _wide(columns)
    else:
        position, run, up, deviation, row = _long(columns)
    if not mapping.trusted:
        check_deviations(deviation, position, columns.table.source)
    sense = mapping.senses or mapping.axis
    if mapping.sign == "nominal-minus-actual" and not (mapping.actual or columns.has("actual")):
        deviation = -deviation
    n = len(position)
    numbers = columns.in_machine({mapping.axis: position})
    numbers |= {f"dir_{mapping.axis}": np.where(up, 1.0, -1.0), "repeat": run}
    numbers |= {f"g{axis}": np.full(n, float(axis == sense)) for axis in "xyz"} | {"displacement": deviation}
    taken = ("position", "actual", "deviation", "run", "direction", "repeat", mapping.axis, f"dir_{mapping.axis}")
    numbers |= {role: values[row] for role, values in columns.others(taken).items()}
    term = f"E{sense.upper()}{mapping.axis.upper()}"
    described: dict[str, object] = {"method": "direct", "datum": "offset", "terms": [term]}
    described |= {"setups": [{"id": name}], "repeats": int(run.max(initial=0.0)) + 1}
    return Rows(numbers, {"setup": np.full(n, name)}, row, described)


Series = tuple[Array, Array, np.ndarray, Array, np.ndarray]
"""Position, run from 0, whether it went up, deviation, and the row in the table."""


def _wide(columns: Columns) -> Series:
    table, mapping = columns.table, columns.mapping
    if not mapping.transposed:
        columns.need(("position",), "the target position")
    position = _header(columns) if mapping.transposed else columns.filled("position")
    _refuse_repeated(table, position, transposed=mapping.transposed)
    known = {rule.column for rule in (*mapping.columns.values(), *mapping.extras.values())}
    names = [str(name) for name in table.cells[:, 0]] if mapping.transposed else list(table.names)
    runs = mapping.runs or _named(table, [name for name in names if name and name not in known])
    series: list[Series] = []
    count = {"up": 0, "down": 0}
    for entry in runs:
        what = f"run {count[entry.direction] + 1} {entry.direction}"
        unit = columns.unit_of("actual" if mapping.actual else "deviation", entry.column)
        columns.read[what] = (entry.column, unit)
        if mapping.transposed:
            if names.count(entry.column) != 1:
                times = names.count(entry.column)
                raise SessionError(f"{table.source}: {times} rows begin with {entry.column!r} ({what})")
            at = names.index(entry.column)
            values = table.parsed(table.cells[at, 1:].astype(np.str_), what, unit, [table.lines[at]] * len(position))
            row = np.full(len(position), at)
        else:
            values, row = table.numbers(entry.column, what, unit), np.arange(len(table))
        if mapping.actual:
            values = values - position
        order = np.argsort(position, kind="stable")
        if entry.direction == "down":
            order = order[::-1]
        number = np.full(len(order), float(count[entry.direction]))
        count[entry.direction] += 1
        up = np.full(len(order), entry.direction == "up")
        series.append((position[order], number, up, values[order], row[order]))
    position, number, up, values, row = (np.concatenate(parts) for parts in zip(*series, strict=True))
    return position, number, up, values, row


def _refuse_repeated(table: TextTable, position: Array, *, transposed: bool) -> None:
    """A run comes to each position once: what stands twice is a slip, or a table that goes there and back."""
    place = groups(np.round(position * 1e9))
    again = np.flatnonzero(occurrence(place) > 0)
    if len(again):
        first = int(np.flatnonzero(place == place[again[0]])[0])
        where = f"{table.source} line {table.header_line}" if transposed else table.where(int(again[0]))
        also = "" if transposed else f", and {table.where(first)}"
        raise SessionError(
            f"{where}: position {1e3 * position[again[0]]:.6g} mm stands there twice{also}; of rows that go there and "
            "back each is a reading of its own (layout: long)"
        )


def _header(columns: Columns) -> Array:
    """Target positions from the header, without its first name."""
    table = columns.table
    unit = columns.unit_of("position", table.names[0])
    columns.read["position"] = ("(the header)", unit)
    cells = np.array(table.names[1:], dtype=np.str_)
    values = table.parsed(cells, "position in the header", unit, [table.header_line] * len(cells))
    if not np.isfinite(values).all():
        raise SessionError(f"{table.source} line {table.header_line}: a position in the header is empty")
    return values


def _named(table: TextTable, names: list[str]) -> tuple[Run, ...]:
    """Runs from the names of their columns, such as `1 up`, `down 2`, `3 -`."""
    runs = []
    for name in names:
        match = _NAME.fullmatch(name.strip())
        sense = match["sense"].lower() if match else ""
        if sense in ("1", "-1", "+1") or sense not in _UP + _DOWN:
            raise SessionError(
                f"{table.source}: the name {name!r} does not say which run it is (such as '1 up', '1 down'); "
                "name the runs, as in --up NAME --down NAME"
            )
        runs.append(Run(column=name, direction="up" if sense in _UP else "down"))
    if not runs:
        raise SessionError(f"{table.source}: no run beside the positions")
    return tuple(runs)


def _long(columns: Columns) -> Series:
    table = columns.table
    columns.need(("position", "direction"), "a row for each reading")
    position = columns.filled("position")
    deviation = _read(columns, "actual", position)
    up = _of_two(columns, "direction", _UP, _DOWN, "up nor down")
    if columns.has("run"):
        run = _whole(columns, "run")
    else:
        run = occurrence(groups(np.round(position, 9), up)).astype(float)
    return position, run, up, deviation, np.arange(len(table))


def _whole(columns: Columns, role: str) -> Array:
    """(rows,) whole numbers of a column, from 0; a SessionError names the line of one that is none."""
    number = columns.filled(role)
    if (wrong := first_true(number != np.floor(number))) is not None:
        raise SessionError(f"{columns.table.where(wrong)}: {role} is {number[wrong]:g}, not a whole number")
    return np.asarray(number - number.min())


def _read(columns: Columns, whole: str, nominal: Array | float) -> Array:
    """(rows,) deviations that were read, or the whole of what was less its nominal value."""
    if columns.has(whole):
        return columns.number(whole) - nominal
    columns.need(("deviation",), f"or {whole}: what was read")
    return columns.number("deviation")


def _of_two(columns: Columns, role: str, one: Collection[str], other: Collection[str], known: str) -> BoolArray:
    """(rows,) whether a column's word is of one kind; a SessionError names the line of one that is of neither."""
    words = np.char.lower(columns.text(role))
    found = np.isin(words, [*one])
    if (bad := first_true(~found & ~np.isin(words, [*other]))) is not None:
        raise SessionError(f"{columns.table.where(bad)}: {role} is {str(words[bad])!r}, neither {known}")
    return np.asarray(found)


_CCW = ("ccw", "+", "+1", "1", "g3", "g03", "left", "↺")
_CW = ("cw", "-", "-1", "g2", "g02", "right", "↻")
# Steps of which most go the way round: a trigger scatters. Readings that a run has at least. Share of the usual step
# below which nothing moved.
_WINDOW, _FEWEST, _STANDS = 5, 8, 0.25
# How far before a reading an axis's sense is looked at: where it turns round it still has that of the way there, rad.
_BEFORE = 1e-6


def circle_rows(columns: Columns, name: str) -> Rows:
    """A reading for each angle, at the place on the circle that the setup states; `name` is the setup's id.

    Runs are told apart by the way round, that of a column `way` or of the angles' own order, and by a column `repeat`.
    """
    columns.need(("angle",), "where on the circle")
    setup = _setup(columns, name)
    angle = columns.filled("angle")
    deviation = _read(columns, "radius", setup.radius)
    if columns.mapping.sign == "nominal-minus-actual" and not columns.has("radius"):
        deviation = -deviation
    sense, run = _runs(columns, angle)
    place = places(setup, angle)[0]
    tangent = places(setup, angle - sense * _BEFORE)[1]
    numbers: dict[str, Array] = dict(zip("xyz", place.T, strict=True))
    for axis in setup.plane:
        numbers[f"dir_{axis.lower()}"] = np.where(sense * tangent[:, "XYZ".index(axis)] < 0.0, -1.0, 1.0)
    number = _whole(columns, "repeat") if columns.has("repeat") else _repeats(sense, run)
    numbers |= {"repeat": number, "displacement": deviation}
    numbers |= columns.others(("angle", "radius", "deviation", "way", "repeat", *numbers))
    entry = setup.model_dump(exclude_none=True, mode="json")
    described = {"method": "ball_bar", "setups": [entry], "repeats": int(number.max(initial=0.0)) + 1}
    return Rows(numbers, {"setup": np.full(len(angle), setup.id)}, np.arange(len(angle)), described)


def _repeats(sense: Array, run: IntArray) -> Array:
    """(n,) repeat of each reading: the first run counter-clockwise and the first clockwise are the first one."""
    number = np.zeros(len(run))
    for way in (-1.0, 1.0):
        mine = sense == way
        number[mine] = np.unique(run[mine], return_inverse=True)[1]
    return number


def _setup(columns: Columns, name: str) -> CircleSetup:
    """The circle of the table: the only one that is described, or that of several whose id is the table's name."""
    setups = columns.mapping.session.get("setups")
    entries = [one for one in setups if isinstance(one, dict)] if isinstance(setups, list) else []
    mine = entries if len(entries) == 1 else [one for one in entries if str(one.get("id")) == name]
    if len(mine) != 1:
        raise SessionError(
            f"{columns.table.source}: session.setups must say which circle {name!r} is, as in "
            "- {id: XY, plane: XY, centre: [0.25, 0.2, 0.1], radius: 0.15}"
        )
    return validated(CircleSetup, {"id": name, **mine[0]}, f"{columns.table.source}: session.setups")


def _runs(columns: Columns, angle: Array) -> tuple[Array, IntArray]:
    """(n,) sense of each reading, and (n,) number of its run: one way round without a break."""
    if columns.has("way"):
        sense = np.where(_of_two(columns, "way", _CCW, _CW, "ccw nor cw"), 1.0, -1.0)
        return sense, np.cumsum(np.diff(sense, prepend=sense[:1]) != 0.0)
    step = np.angle(np.exp(1j * np.diff(angle, prepend=2.0 * angle[:1] - angle[1:2])))
    # Where a run begins at the place at which the last one ended, the next step says which way it goes.
    moves = np.abs(step) > _STANDS * np.median(np.abs(step))
    after = np.minimum.accumulate(np.where(moves, np.arange(len(step)), len(step) - 1)[::-1])[::-1]
    sense = median_filter(np.sign(step[after]), _WINDOW, mode="nearest")
    run = np.cumsum(np.diff(sense, prepend=sense[:1]) != 0.0)
    if (sense == 0.0).any() or np.bincount(run).min() < _FEWEST:
        raise SessionError(
            f"{columns.table.source}: the angles go neither one way round nor first one and then the other; a column "
            "way (ccw, cw) says which readings belong together"
        )
    return sense, run
