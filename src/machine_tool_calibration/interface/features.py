# SPDX-License-Identifier: Apache-2.0
"""Features of a probed part as a table, a picture and a text."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import pandas as pd

from machine_tool_calibration.interface.show import Answer, notebook
from machine_tool_calibration.methods.probing.features import Features as Found
from machine_tool_calibration.methods.probing.propagation import MonteCarlo
from machine_tool_calibration.plots.features import draw_features
from machine_tool_calibration.reports.features import features_document, show_features
from machine_tool_calibration.session.provenance import Provenance

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

__all__ = ["Features"]


@dataclass(frozen=True, eq=False, repr=False)
class Features(Answer[Found]):
    """Pins, holes, spheres and walls of a probed part, distances and angles between them.

    Attributes:
        drawn: what draws gave; None without any.
        origin: what it was made from.
    """

    drawn: MonteCarlo | None
    origin: Provenance

    @property
    def datum(self) -> str:
        """The frame in words, and what the lengths are relative to."""
        return self.found.datum

    @cached_property
    def table(self) -> pd.DataFrame:
        """One quantity a row, by its name: `pin1 x`, `pin1-pin5 distance`; SI.

        Columns: `nominal`, `deviation` (actual minus nominal) and its standard uncertainty `u` in `unit`,
        `determined`; with draws `u_draws` and the ends of the interval of the deviation, `low` and `high`.
        """
        found, drawn = self.found, self.drawn
        columns: dict[str, Any] = {
            "nominal": [asked.nominal for asked in found.quantities],
            "deviation": found.deviation,
            "u": found.uncertainty,
            "unit": [asked.unit for asked in found.quantities],
            "determined": pd.notna(found.deviation),
        }
        if drawn is not None:
            columns |= {"u_draws": drawn.uncertainty}
            columns |= {"low": found.deviation + drawn.low, "high": found.deviation + drawn.high}
        return pd.DataFrame(columns, index=pd.Index(self._names, name="quantity"))

    @cached_property
    def covariance(self) -> pd.DataFrame:
        """Joint covariance of all quantities of the table, in the products of their units."""
        return pd.DataFrame(self.found.covariance, self._names, self._names)

    @property
    def headline(self) -> str:
        """What it is, in one line."""
        return f"{', '.join(one.name for one in self.found.elements)}; frame: {self.datum}"

    def show(self, screen: Console, /) -> None:
        """Print what `mtcal features` prints."""
        show_features(screen, self.found, self.drawn)

    def plot(self) -> Figure:
        """Where the features are, deviations magnified, with ellipses of their uncertainty."""
        return notebook(draw_features(self.found))

    @cached_property
    def _document(self) -> dict[str, Any]:
        return {**features_document(self.found, self.drawn), "provenance": self.origin.document()}

    @property
    def _names(self) -> list[str]:
        return [asked.name for asked in self.found.quantities]
