# SPDX-License-Identifier: Apache-2.0
"""The readings of one window in one source for all plots, so that a selection in one lights up in every other."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.diagnosis.comparison import Comparison
from machine_tool_calibration.plots.residuals import axis_label, planes
from machine_tool_calibration.workbench.look import setup_color
from machine_tool_calibration.workbench.models import Model
from machine_tool_calibration.workbench.state import State

__all__ = ["DRAWN", "VIEWS", "Readings"]

VIEWS = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
"""Planes in which places are drawn."""
# Share of the largest extent that an arrow of the bulk's largest residual takes.
_LENGTH = 0.12
_MORE, _LESS = "#d55e00", "#0072b2"


class Readings:
    """All readings of the window's measurement, those set aside too; of several sessions one after the other.

    Columns of the source: `row` (with the session's name where there are several), `setup`, `repeat`, `color` of the
    setup; places `x y z` (mm); every covariate under `c:NAME` in the unit of its label; `measured`, `predicted`,
    `residual` (µm; NaN where set aside), `studentized`; `aside` (µm, of one that is set aside the residual that it had
    before); `pattern` (µm, what an effect that is looked at would take out); for each plane of `VIEWS` the end of the
    residual's arrow, such as `xy:u`, `xy:v` (mm), and `arrow`, its colour.

    Attributes:
        source: what plots draw.
        labels: of each covariate by its column.
        ranked: the columns of covariates, those first that the first model's residuals follow.
        scale: residual that an arrow as long as `_LENGTH` of the extent stands for, m.
    """

    def __init__(self, state: State) -> None:
        self.source = ColumnDataSource({name: [] for name in _FIXED + _CHANGING + _OF_PAGES})
        self.labels: dict[str, str] = {}
        self.ranked: list[str] = []
        self.scale = 0.0
        self._state = state
        self._measurement: object = None
        self._number = np.zeros(0, dtype=np.int64)
        self._place = self._direction = np.zeros((0, 3))
        self.planes: list[str] = ["xy"]
        self._waiting: dict[str, Any] | None = None

    def refresh(self) -> None:
        """Draw the model in use."""
        measurement = self._state.subject.measurement
        if measurement is not self._measurement:
            self._measurement = measurement
            data = self._fixed()
            self.source.selected.indices = []
            self.source.data = data | self._changing()
        else:
            self._send(self._changing())

    @property
    def selected(self) -> list[int]:
        """Numbers of the readings that are selected."""
        return [int(self._number[k]) for k in self.source.selected.indices]

    def show_pattern(self, trial: Model | None) -> Array:
        """Lay what a model with one effect more would take out over the residuals; nothing if there is none.

        Returns:
            (n,) that, µm, NaN where a reading is not in the model.
        """
        if trial is None:
            pattern = np.full(len(self._number), np.nan)
        else:
            pattern = 1e6 * (self._of(self._state.model, "residual") - self._of(trial, "residual"))
        self._send({"pattern": pattern})
        return pattern

    def draw(self, **columns: str) -> None:
        """Have the plots' own columns (`DRAWN`) hold what other columns do.

        A plot that is told to draw another column goes on looking for its points where they were.
        """
        held = {**self.source.data, **(self._waiting or {})}
        self._send({name: held[column] for name, column in columns.items()})

    def select(self, numbers: Iterable[int]) -> None:
        """Light up readings."""
        self.source.selected.indices = np.flatnonzero(np.isin(self._number, sorted(numbers))).tolist()

    def _fixed(self) -> dict[str, object]:
        """Of the first model, which has every reading that can be used unless its history begins later."""
        state, subject = self._state, self._state.subject
        first = state.models[0]
        there = [np.isfinite(session.readings.displacement) for session in state.sessions]
        taken = [session.readings.select(one) for session, one in zip(state.sessions, there, strict=True)]
        self._number = np.concatenate([subject.numbers(k, one.row) for k, one in enumerate(taken)])
        seen = [one.fit.model.observations for one in first.each]
        place, direction = (np.concatenate([getattr(o, what) for o in seen]) for what in ("position", "direction"))
        self.planes = ["xyz"[a] + "xyz"[b] for a, b in planes(place, direction)]
        self._place = np.column_stack([self._of(first, f"position.{k}") for k in range(3)])
        self._direction = np.column_stack([self._of(first, f"direction.{k}") for k in range(3)])
        self.labels = {f"c:{name}": axis_label(name)[0] for one in first.each for name in one.covariates}
        share: dict[str, float] = {}
        for one in first.each:
            for name, value in one.ranked:
                share[f"c:{name}"] = max(value, share.get(f"c:{name}", 0.0))
        self.ranked = sorted(share, key=lambda name: -share[name])
        self.ranked += [name for name in self.labels if name not in self.ranked]
        color = 0
        setups, colors = [], []
        for k, (session, readings) in enumerate(zip(state.sessions, taken, strict=True)):
            named = "" if first.labels is None else f"{first.labels[k]}/"
            setups += [named + session.setup_ids[int(s)] for s in readings.setup]
            colors += [setup_color(color + int(s)) for s in readings.setup]
            color += len(session.setup_ids)
        return {
            **dict.fromkeys(_OF_PAGES, np.full(len(self._number), np.nan)),
            "row": [subject.name(int(number)) for number in self._number],
            "setup": setups,
            "repeat": np.concatenate([one.repeat for one in taken]),
            "color": colors,
            "measured": 1e6 * np.concatenate([one.displacement for one in taken]),
            **{name: 1e3 * values for name, values in zip("xyz", self._place.T, strict=True)},
            **{column: axis_label(column[2:])[1] * self._of(first, column) for column in self.labels},
        }

    def _changing(self) -> dict[str, object]:
        model = self._state.model
        residual = self._of(model, "residual")
        self.scale = _bulk(residual)
        return {
            "aside": self._before(residual),
            "predicted": 1e6 * self._of(model, "predicted"),
            "residual": 1e6 * residual,
            "studentized": self._of(model, "studentized"),
            "pattern": np.full(len(self._number), np.nan),
            "arrow": np.where(residual > 0, _MORE, _LESS).tolist(),
            **self._arrows(residual, self.scale),
        }

    def show_side_by_side(self, before: Model, after: Model) -> float:
        """Arrows of the residuals of two models to one scale, in columns `before:xy:u`, `after:xy:u` and so on.

        Returns:
            What the longest arrows stand for, m.
        """
        both = {"before": self._of(before, "residual"), "after": self._of(after, "residual")}
        scale = max(_bulk(residual) for residual in both.values())
        for name, residual in both.items():
            self._send({f"{name}:{end}": at for end, at in self._arrows(residual, scale).items()})
        return scale

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Whatever is changed meanwhile goes to the browser in one piece: all plots draw themselves anew for each."""
        if self._waiting is not None:
            yield
            return
        self._waiting = {}
        try:
            yield
        finally:
            waiting, self._waiting = self._waiting, None
            self._send(waiting)

    def _send(self, columns: Mapping[str, Any]) -> None:
        """Change columns of the source; those that stay the same are not sent."""
        if self._waiting is not None:
            self._waiting |= columns
            return
        changed = {name: values for name, values in columns.items() if not _same(self.source.data[name], values)}
        if changed:
            self.source.data.update(changed)

    def _arrows(self, residual: Array, scale: float) -> dict[str, Array]:
        """Ends of the arrows of residuals (m) in every plane, mm."""
        extent = float(np.nanmax(np.ptp(self._place, axis=0))) if len(self._place) else 1.0
        factor = 1e3 * _LENGTH * extent / max(scale, 1e-12)
        tip = 1e3 * self._place + factor * residual[:, None] * self._direction
        return {
            f"{view}:{end}": tip[:, k] for view in self.planes for end, k in zip("uv", VIEWS[view], strict=True)
        }

    def _before(self, residual: Array) -> Array:
        """(n,) residual of the readings that are set aside in the last model that had them, µm; NaN of all others."""
        out = np.where(np.isin(self._number, sorted(self._state.model.aside)), np.nan, 0.0)
        for model in reversed(self._state.models[:-1]):
            if not np.isnan(out).any():
                break
            out = np.where(np.isnan(out), 1e6 * self._of(model, "residual"), out)
        return np.where(np.isnan(residual), out, np.nan)

    def _of(self, model: Model, what: str) -> Array:
        """(n,) what a model says of every reading: a quantity of `_value`; NaN of those that it does not have."""
        out = np.full(len(self._number), np.nan)
        for k, found in enumerate(model.each):
            values = _value(found, what)
            if values is not None:
                numbers = self._state.subject.numbers(k, found.fit.model.observations.readings.row)
                out[np.searchsorted(self._number, numbers)] = values
        return out


def _value(found: Comparison, what: str) -> Array | None:
    """An attribute of a comparison, `position.0` to `direction.2`, or a covariate by its column, such as `c:time`."""
    if what.startswith("c:"):
        return found.covariates.get(what[2:])
    name, _, axis = what.partition(".")
    if axis:
        return np.asarray(getattr(found.fit.model.observations, name)[:, int(axis)])
    return np.asarray(getattr(found, name))


def _same(one: Any, other: Any) -> bool:
    if one is other:
        return True
    a, b = np.asarray(one), np.asarray(other)
    return a.shape == b.shape and np.array_equal(a, b, equal_nan=a.dtype.kind == b.dtype.kind == "f")


def _bulk(residual: Array) -> float:
    """Size of the largest residuals but for a few, m."""
    size = np.abs(residual[np.isfinite(residual)])
    return float(np.quantile(size, 0.98)) if len(size) else 0.0


_FIXED = ("row", "setup", "repeat", "color", "measured", "x", "y", "z")
_ENDS = tuple(f"{view}:{end}" for view in VIEWS for end in "uv")
_CHANGING = ("aside", "predicted", "residual", "studentized", "pattern", "arrow", *_ENDS)
# What single pages fill; there from the start, as plots ask for them.
DRAWN = ("against0", "against1", "over", "across", "up", "u", "v", "place_a", "place_b", *(
    f"{name}_{end}" for name in ("before", "after") for end in "uv"
))  # fmt: skip
"""Columns that plots draw, filled from others as the user chooses."""
_OF_PAGES = ("3d:u", "3d:v", *DRAWN, *(f"{name}:{end}" for name in ("before", "after") for end in _ENDS))
