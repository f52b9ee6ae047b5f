# SPDX-License-Identifier: Apache-2.0
"""The readings of one window in one source for all plots, so that a selection in one lights up in every other."""

from __future__ import annotations

import numpy as np
from bokeh.models import ColumnDataSource

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.plots.residuals import axis_label, planes
from machine_tool_calibration.workbench.look import setup_color
from machine_tool_calibration.workbench.state import Model, State

__all__ = ["DRAWN", "VIEWS", "Readings"]

VIEWS = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
"""Planes in which places are drawn."""
# Share of the largest extent that an arrow of the bulk's largest residual takes.
_LENGTH = 0.12
_MORE, _LESS = "#d55e00", "#0072b2"


class Readings:
    """All readings of the window's measurement, those set aside too.

    Columns of the source: `row`, `setup`, `repeat`, `color` of the setup; places `x y z` (mm); every covariate under
    `c:NAME` in the unit of its label; `measured`, `predicted`, `residual` (µm; NaN where set aside), `studentized`;
    `aside` (µm, of one that is set aside the residual that it had before); `pattern` (µm, what an effect that is looked
    at would take out); for each plane of `VIEWS` the end of the residual's arrow, such as `xy:u`, `xy:v` (mm), and
    `arrow`, its colour.

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
        self._row = np.zeros(0, dtype=np.int64)
        self._place = self._direction = np.zeros((0, 3))
        self.planes: list[str] = ["xy"]

    def refresh(self) -> None:
        """Draw the model in use."""
        if self._state.measurement is not self._measurement:
            self._measurement = self._state.measurement
            data = self._fixed()
            self.source.selected.indices = []
            self.source.data = data | self._changing()
        else:
            self.source.data.update(self._changing())

    @property
    def selected(self) -> list[int]:
        """Rows of the readings that are selected."""
        return [int(self._row[k]) for k in self.source.selected.indices]

    def show_pattern(self, rows: IntArray, pattern: Array) -> None:
        """Lay what an effect would take out of some readings (m) over the residuals."""
        self.source.data["pattern"] = self._at(rows, 1e6 * pattern)

    def draw(self, **columns: str) -> None:
        """Have the plots' own columns (`DRAWN`) hold what other columns do.

        A plot that is told to draw another column goes on looking for its points where they were.
        """
        self.source.data.update({name: self.source.data[column] for name, column in columns.items()})

    def select(self, rows: list[int]) -> None:
        """Light up readings."""
        self.source.selected.indices = np.flatnonzero(np.isin(self._row, rows)).tolist()

    def _fixed(self) -> dict[str, object]:
        """Of the first model, which has every reading that can be used unless its history begins later."""
        session = self._state.session
        readings = session.readings
        first = self._state.models[0].comparison
        observations = first.fit.model.observations
        there = np.isfinite(readings.displacement)
        self._row = readings.row[there]
        self._place = np.column_stack([self._at(observations.readings.row, o) for o in observations.position.T])
        self._direction = np.column_stack([self._at(observations.readings.row, o) for o in observations.direction.T])
        self.planes = ["xyz"[a] + "xyz"[b] for a, b in planes(observations.position, observations.direction)]
        self.labels = {f"c:{name}": axis_label(name)[0] for name in first.covariates}
        self.ranked = [f"c:{name}" for name, _ in first.ranked]
        self.ranked += [name for name in self.labels if name not in self.ranked]
        setup = readings.setup[there]
        return {
            **dict.fromkeys(_OF_PAGES, np.full(len(self._row), np.nan)),
            "row": self._row,
            "setup": [session.setup_ids[int(k)] for k in setup],
            "repeat": readings.repeat[there],
            "color": [setup_color(int(k)) for k in setup],
            "measured": 1e6 * readings.displacement[there],
            **{name: 1e3 * values for name, values in zip("xyz", self._place.T, strict=True)},
            **{
                f"c:{name}": self._at(observations.readings.row, axis_label(name)[1] * values)
                for name, values in first.covariates.items()
            },
        }

    def _changing(self) -> dict[str, object]:
        found = self._state.model.comparison
        rows = found.fit.model.observations.readings.row
        residual = self._at(rows, found.residual)
        self.scale = _bulk(residual)
        return {
            "aside": self._before(residual),
            "predicted": self._at(rows, 1e6 * found.predicted),
            "residual": 1e6 * residual,
            "studentized": self._at(rows, found.studentized),
            "pattern": np.full(len(self._row), np.nan),
            "arrow": np.where(residual > 0, _MORE, _LESS).tolist(),
            **self._arrows(residual, self.scale),
        }

    def show_side_by_side(self, before: Model, after: Model) -> float:
        """Arrows of the residuals of two models to one scale, in columns `before:xy:u`, `after:xy:u` and so on.

        Returns:
            What the longest arrows stand for, m.
        """
        both = {}
        for name, model in (("before", before), ("after", after)):
            found = model.comparison
            both[name] = self._at(found.fit.model.observations.readings.row, found.residual)
        scale = max(_bulk(residual) for residual in both.values())
        for name, residual in both.items():
            self.source.data.update({f"{name}:{end}": at for end, at in self._arrows(residual, scale).items()})
        return scale

    def _arrows(self, residual: Array, scale: float) -> dict[str, Array]:
        """Ends of the arrows of residuals (m) in every plane, mm."""
        extent = float(np.nanmax(np.ptp(self._place, axis=0))) if len(self._place) else 1.0
        factor = 1e3 * _LENGTH * extent / max(scale, 1e-12)
        tip = 1e3 * self._place + factor * residual[:, None] * self._direction
        return {f"{view}:{end}": tip[:, k] for view, pair in VIEWS.items() for end, k in zip("uv", pair, strict=True)}

    def _before(self, residual: Array) -> Array:
        """(n,) residual of the readings that are set aside in the last model that had them, µm; NaN of all others."""
        out = np.where(np.isin(self._row, sorted(self._state.model.aside)), np.nan, 0.0)
        for model in reversed(self._state.models[:-1]):
            if not np.isnan(out).any():
                break
            found = model.comparison
            then = 1e6 * self._at(found.fit.model.observations.readings.row, found.residual)
            out = np.where(np.isnan(out), then, out)
        return np.where(np.isnan(residual), out, np.nan)

    def _at(self, rows: IntArray, values: Array) -> Array:
        """(n,) values of some rows at all rows of the source, NaN at the others."""
        out = np.full(len(self._row), np.nan)
        place = np.searchsorted(self._row, rows)
        out[place] = values
        return out


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
