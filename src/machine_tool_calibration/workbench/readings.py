# SPDX-License-Identifier: Apache-2.0
"""The readings of one window for all plots, so that a selection in one lights up in every other."""

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import pandas as pd
from bokeh.models import ColumnDataSource

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.plots.residuals import axis_label, line_of, planes, sense_along
from machine_tool_calibration.plots.residuals import color as setup_color
from machine_tool_calibration.plots.style import magnification
from machine_tool_calibration.workbench.look import packed
from machine_tool_calibration.workbench.models import Model
from machine_tool_calibration.workbench.state import State

VIEWS = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
"""Planes in which places are drawn."""
_LENGTH = 0.12  # share of the largest extent that an arrow of the bulk's largest residual takes at most
_MORE, _LESS = packed("#d55e00"), packed("#0072b2")

_COLORS = ("color", "arrow")  # columns of packed colours


class Readings:
    """All readings of the window's measurement, those set aside too; of several sessions one after the other.

    Columns: `row` (with the session's name where there are several), `setup`, `repeat`, `color` of the setup; places
    `x y z` (mm); every covariate under `c:NAME` in the unit of its label; `measured`, `predicted`, `residual` (µm; NaN
    where set aside), `studentized`; `aside` (µm, of one that is set aside the residual that it had before); `pattern`
    (µm, what an effect that is looked at would take out); for each plane of `VIEWS` the end of the residual's arrow,
    such as `xy:u`, `xy:v` (mm), and `arrow`, its colour; and what pages add.

    Each page draws from a source of its own, which holds what that page needs: a browser works on every plot whose
    source changes, a hidden one too.
    """

    def __init__(self, state: State) -> None:
        self.data: dict[str, Any] = {}  # the columns
        self.labels: dict[str, str] = {}  # of each covariate by its column
        self.ranked: list[str] = []  # the columns of covariates, those first that the first model's residuals follow
        # of the residuals that are drawn as arrows; 0 where they cannot be, as at a single place
        self.magnification = 0.0
        self._state = state
        self._measurement: object = None
        self._number = np.zeros(0, dtype=np.int64)
        self._place = np.zeros((0, 3))
        self._arrow: dict[str, Array] = {}
        self.planes: list[str] = ["xy"]  # in which the readings extend, or are sensed
        self.arrows = "Residuals"  # what they show, in words
        self._sources: dict[str, ColumnDataSource] = {}
        self._page = ""
        self.chosen: list[int] = []  # places in the columns of the readings that are selected
        self._held = False

    def source(self, page: str, *columns: str) -> ColumnDataSource:
        """What the plots of a page draw."""
        for name in columns:
            self.data.setdefault(name, self._empty(name))
        source = self._sources[page] = ColumnDataSource({name: self.data[name] for name in columns})
        source.selected.on_change("indices", lambda attr, old, new: self._choose(page, new))
        return source

    def look_at(self, page: str) -> None:
        """Another page is looked at: its source is brought up to date."""
        self._page = page
        self._send()
        if page in self._sources:
            self._sources[page].selected.indices = self.chosen

    def refresh(self) -> None:
        """Hold the model in use."""
        measurement = self._state.subject.measurement
        if measurement is not self._measurement:
            self._measurement = measurement
            fixed = self._fixed()
            self.select([])
            self.show({**{name: self._empty(name) for name in self.data}, **fixed, **self._changing()})
        else:
            self.show(self._changing())

    @property
    def selected(self) -> list[int]:
        """Numbers of the readings that are selected."""
        return [self.number(k) for k in self.chosen]

    def number(self, k: int) -> int:
        """Of the reading at a place in the columns."""
        return int(self._number[k])

    def show_pattern(self, trial: Model | None) -> Array:
        """Lay what a model with one effect more would take out over the residuals; nothing if there is none.

        (n,) that, µm, NaN where a reading is not in the model.
        """
        if trial is None:
            pattern = np.full(len(self._number), np.nan)
        else:
            pattern = 1e6 * (self._residual(self._state.model) - self._residual(trial))
        self.show({"pattern": pattern})
        return pattern

    def draw(self, **columns: str) -> None:
        """Have columns of a page hold what others do.

        A plot that is told to draw another column goes on looking for its points where they were.
        """
        self.show({name: self.data[column] for name, column in columns.items()})

    def show(self, columns: Mapping[str, Any]) -> None:
        """Change columns."""
        self.data |= columns
        self._send()

    def select(self, numbers: Iterable[int]) -> None:
        """Light up readings."""
        self.chosen = np.flatnonzero(np.isin(self._number, sorted(numbers))).tolist()
        if self._page in self._sources:
            self._sources[self._page].selected.indices = self.chosen

    def select_rows(self, words: str) -> None:
        """Light up readings by their rows, such as `264, 470-476`, of several sessions `cube:264, cube:470-476`."""
        rows = [name.rpartition(":") for name in self.data.get("row", ())]
        chosen: set[int] = set()
        for part in map(str.strip, words.split(",")):
            found = re.fullmatch(r"(?:(.*):)?(\d{1,9})(?:-(\d{1,9}))?", part)
            label, first, last = found.groups(default="") if found else ("", "-1", "")
            ends = int(first), int(last or first)
            mine = {k for k, (of, _, row) in enumerate(rows) if of == label and ends[0] <= int(row) <= ends[1]}
            if not mine:
                such = f"264, 470-476{f' or {rows[0][0]}:264' if rows and rows[0][0] else ''}"
                raise CalibrationError(f"{part!r}: no reading is there; say rows as {such}")
            chosen |= mine
        self.select(self._number[sorted(chosen)].tolist())

    def _empty(self, name: str) -> Array:
        count = len(self._number)
        return np.zeros(count, dtype=np.uint32) if name in _COLORS else np.full(count, np.nan)

    def _choose(self, page: str, chosen: list[int]) -> None:
        if page == self._page:
            self.chosen = chosen

    def _fixed(self) -> dict[str, object]:
        """Of the first model, which has every reading that can be used unless its history begins later."""
        state, subject = self._state, self._state.subject
        first = state.models[0]
        there = [np.isfinite(session.readings.displacement) for session in state.sessions]
        taken = [session.readings.select(one) for session, one in zip(state.sessions, there, strict=True)]
        self._number = np.concatenate([subject.numbers(k, one.row) for k, one in enumerate(taken)])
        axes = [f"{what}_{axis}" for what in ("position", "direction") for axis in "xyz"]
        found = self._of(first, *axes, *(f"c:{name}" for one in first.each for name in one.covariates))
        seen = [one.fit.model.observations for one in first.each]
        self._place, sensed = np.split(found[axes].to_numpy(), 2, axis=1)
        known = np.isfinite(sensed[:, 0])
        self.planes = ["xyz"[a] + "xyz"[b] for a, b in planes(self._place[known], sensed[known])]
        self._arrow = {view: sensed[:, VIEWS[view]] for view in self.planes}
        self.arrows = "Residuals"
        lines = [line_of(one.position, one.direction) for one in seen]
        of_session = np.searchsorted(subject.first, self._number, side="right") - 1
        for k, line in enumerate(lines):
            for view, arrow in self._arrow.items():
                if line is not None:  # arrows would lie on each other; of one that is seen end-on all at one place
                    up = [line in VIEWS[view] and axis != line for axis in VIEWS[view]]
                    arrow[of_session == k] = sense_along(sensed[of_session == k], line)[:, None] * up
        along = ["xyz"[line] for line in sorted({line for line in lines if line is not None})]
        if along:
            self.arrows += ", those along " if None in lines else " along "
            self.arrows += ", ".join(along) + f", standing up from the line{'s' if len(along) > 1 else ''}"
        self.labels = {f"c:{name}": axis_label(name)[0] for one in first.each for name in one.covariates}
        share = pd.DataFrame([dict(one.ranked) for one in first.each]).max().clip(lower=0.0)
        self.ranked = [f"c:{name}" for name in share.sort_values(ascending=False, kind="stable").index]
        self.ranked += [name for name in self.labels if name not in self.ranked]
        color = 0
        setups, colors = [], []
        for k, (session, readings) in enumerate(zip(state.sessions, taken, strict=True)):
            named = "" if first.comparison.labels is None else f"{first.comparison.labels[k]}/"
            setups += [named + session.setup_ids[int(s)] for s in readings.setup]
            colors += [packed(setup_color(color + int(s))) for s in readings.setup]
            color += len(session.setup_ids)
        return {
            "row": [subject.name(int(number)) for number in self._number],
            "setup": setups,
            "repeat": np.concatenate([one.repeat for one in taken]),
            "color": np.array(colors, dtype=np.uint32),
            "measured": 1e6 * np.concatenate([one.displacement for one in taken]),
            **{name: 1e3 * values for name, values in zip("xyz", self._place.T, strict=True)},
            **{column: axis_label(column[2:])[1] * found[column].to_numpy() for column in self.labels},
        }

    def _changing(self) -> dict[str, object]:
        found = self._of(self._state.model, "predicted", "residual", "studentized")
        residual = found["residual"].to_numpy()
        self.magnification = self._magnification(residual)
        return {
            "aside": self._before(residual),
            "predicted": 1e6 * found["predicted"].to_numpy(),
            "residual": 1e6 * residual,
            "studentized": found["studentized"].to_numpy(),
            "pattern": np.full(len(self._number), np.nan),
            "arrow": np.where(residual > 0, _MORE, _LESS).astype(np.uint32),
            **self._arrows(residual, self.magnification),
        }

    def show_side_by_side(self, before: Model, after: Model) -> float:
        """Arrows of the residuals of two models, in columns `before:xy:u`, `after:xy:u` …; their magnification."""
        both = {"before": self._residual(before), "after": self._residual(after)}
        factor = self._magnification(*both.values())
        for name, residual in both.items():
            self.show({f"{name}:{end}": at for end, at in self._arrows(residual, factor).items()})
        return factor

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Whatever is changed meanwhile goes to the browser in one piece: all plots draw themselves anew for each."""
        held, self._held = self._held, True
        try:
            yield
        finally:
            self._held = held
            self._send()

    def _send(self) -> None:
        """Bring the source of the page that is looked at up to date; columns that stay the same are not sent."""
        source = self._sources.get(self._page)
        if self._held or source is None:
            return
        columns = {name: self.data[name] for name in source.data}
        if {len(values) for values in source.data.values()} != {len(values) for values in columns.values()}:
            source.data = columns
            return
        changed = {name: values for name, values in columns.items() if not _same(source.data[name], values)}
        if changed:
            source.data.update(changed)

    def _magnification(self, *residuals: Array) -> float:
        """A round one in which the residuals (m) of one or several models can be seen, a few outliers aside; or 0."""
        size = [np.abs(residual[np.isfinite(residual)]) for residual in residuals]
        bulk = max((float(np.quantile(one, 0.98)) for one in size if len(one)), default=0.0)
        known = self._place[np.isfinite(self._place).all(axis=1)]
        extent = float(np.ptp(known, axis=0).max()) if len(known) else 0.0
        return magnification(bulk, extent, _LENGTH, 0.0)

    def _arrows(self, residual: Array, factor: float) -> dict[str, Array]:
        """Ends of the magnified arrows of residuals (m) in every plane, mm."""
        return {
            f"{view}:{end}": 1e3 * (self._place[:, axis] + factor * residual * along)
            for view, arrow in self._arrow.items()
            for end, axis, along in zip("uv", VIEWS[view], arrow.T, strict=True)
        }

    def _before(self, residual: Array) -> Array:
        """(n,) residual of the readings that are set aside in the last model that had them, µm; NaN of all others."""
        out = np.where(np.isin(self._number, sorted(self._state.model.aside)), np.nan, 0.0)
        for model in reversed(self._state.models[:-1]):
            if not np.isnan(out).any():
                break
            out = np.where(np.isnan(out), 1e6 * self._residual(model), out)
        return np.where(np.isnan(residual), out, np.nan)

    def _residual(self, model: Model) -> Array:
        """(n,) m."""
        return self._of(model, "residual")["residual"].to_numpy()

    def _of(self, model: Model, *columns: str) -> pd.DataFrame:
        """Columns of the residual table or covariates (`c:time`) of all readings; NaN of those not in a model."""
        tables = []
        for k, one in enumerate(model.each):
            table = one.residuals.assign(**{f"c:{name}": values for name, values in one.covariates.items()})
            numbers = self._state.subject.numbers(k, table["row"].to_numpy())
            tables.append(table.reindex(columns=[*dict.fromkeys(columns)]).set_axis(numbers))
        return pd.concat(tables).reindex(self._number)


def _same(one: Any, other: Any) -> bool:
    if one is other:
        return True
    a, b = np.asarray(one), np.asarray(other)
    return a.shape == b.shape and np.array_equal(a, b, equal_nan=a.dtype.kind == b.dtype.kind == "f")
