# SPDX-License-Identifier: Apache-2.0
"""Features of a probed part as tables, a picture, a text and a document."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import pandas as pd

from machine_tool_calibration.coverage import COVERAGE
from machine_tool_calibration.interface.show import Answer, notebook
from machine_tool_calibration.methods.probing.features import Features as Found
from machine_tool_calibration.methods.probing.features import MonteCarlo
from machine_tool_calibration.methods.probing.geometry import Circle
from machine_tool_calibration.plots.features import draw_features
from machine_tool_calibration.plots.style import Figure
from machine_tool_calibration.reports.quantities import NOT_DETERMINED, ROUNDING, decimals, fixed, quantity
from machine_tool_calibration.reports.tables import Part, TextTable
from machine_tool_calibration.session.provenance import Provenance


@dataclass(frozen=True, eq=False, repr=False)
class Features(Answer, Found):
    """Pins, holes, spheres and walls of a probed part, distances and angles between them.

    Attributes:
        drawn: what draws gave; None without any.
        origin: what it was made from.
    """

    drawn: MonteCarlo | None = None
    origin: Provenance = field(kw_only=True)

    @cached_property
    def table(self) -> pd.DataFrame:
        """One quantity a row, by its name: `pin1 x`, `pin1-pin5 distance`; SI.

        Columns: `nominal`, `deviation` (actual minus nominal) and its standard uncertainty `u` in `unit`,
        `determined`; with draws `u_draws` and the ends of the interval of the deviation, `low` and `high`.
        """
        drawn = self.drawn
        columns: dict[str, Any] = {
            "nominal": [asked.nominal for asked in self.quantities],
            "deviation": self.deviation,
            "u": self.uncertainty,
            "unit": [asked.unit for asked in self.quantities],
            "determined": pd.notna(self.deviation),
        }
        if drawn is not None:
            columns |= {"u_draws": drawn.uncertainty}
            columns |= {"low": self.deviation + drawn.low, "high": self.deviation + drawn.high}
        return pd.DataFrame(columns, index=pd.Index(self._names, name="quantity"))

    @cached_property
    def covariance(self) -> pd.DataFrame:
        """Joint covariance of all quantities of the table, in the products of their units."""
        return pd.DataFrame(self.uncertainty_matrix, self._names, self._names)

    @property
    def headline(self) -> str:
        """What it is, in one line."""
        return f"{', '.join(one.name for one in self.elements)}; frame: {self.datum}"

    def parts(self) -> Iterator[Part]:
        """The features with expanded uncertainty (k = 2), their frame, and what gives none."""
        drawn, rows = self.drawn, []
        for asked, row in zip(self.quantities, self.table.to_dict("records"), strict=True):
            told, interval = NOT_DETERMINED, ""
            length = asked.unit == "m"
            nominal = f"{fixed(1e3 * asked.nominal, 4)} mm" if length else f"{fixed(math.degrees(asked.nominal), 4)}°"
            if row["determined"]:
                told = "0 (datum)" if row["u"] < ROUNDING else quantity(row["deviation"], asked.unit, row["u"])
                if drawn is not None and row["u"] >= ROUNDING:
                    ends = (fixed(1e6 * end, decimals(2e6 * row["u"])) for end in (row["low"], row["high"]))
                    interval = f"{' to '.join(ends)} µ{asked.unit}"
            rows.append((", ".join(asked.of), asked.what, nominal, told, interval))
        draws = f"{100 * COVERAGE:.4g} % of {drawn.draws} draws, touches {drawn.distribution}" if drawn else ""
        heads = ("feature", "quantity", "nominal", "actual − nominal", draws)
        title = "Features of the workpiece, ± U (95 %)"
        note = f"frame: {self.datum}; U is without instrument and temperature"
        yield TextTable(title, heads, tuple(rows), note)
        for name, why in self.left_out.items():
            yield f"Not a feature: {name}: {why}."

    def plot(self) -> Figure:
        """Where the features are, deviations magnified, with ellipses of their uncertainty."""
        return notebook(draw_features(self))

    @cached_property
    def _document(self) -> dict[str, Any]:
        drawn = self.drawn
        quantities = []
        for asked, row in zip(self.quantities, self.table.to_dict("records"), strict=True):
            entry = {"features": list(asked.of), "quantity": asked.what, "unit": asked.unit, "nominal": asked.nominal}
            entry |= {"deviation": row["deviation"], "standard_uncertainty": row["u"]}
            if drawn is not None:
                entry["draws"] = {"standard_uncertainty": row["u_draws"], "interval": [row["low"], row["high"]]}
            quantities.append(entry)
        # Pins, discs and spheres are circles.
        kinds = [("hole" if one.hole else "circle") if isinstance(one, Circle) else "line" for one in self.elements]
        named = zip(self.elements, kinds, strict=True)
        document: dict[str, Any] = {
            "format": "mtcal-features/1",
            "datum": self.datum,
            "features": [{"name": one.name, "kind": kind, "points": len(one.index)} for one, kind in named],
            "left_out": [{"name": name, "why": why} for name, why in self.left_out.items()],
            "quantities": quantities,
            "covariance": self.uncertainty_matrix,
            "provenance": self.origin.document(),
        }
        if drawn is not None:
            document |= {"draws": drawn.draws, "distribution": drawn.distribution, "coverage_probability": COVERAGE}
        return document

    @property
    def _names(self) -> list[str]:
        return [asked.name for asked in self.quantities]
