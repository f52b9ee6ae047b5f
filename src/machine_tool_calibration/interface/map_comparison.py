# SPDX-License-Identifier: Apache-2.0
"""Two maps of one machine held against each other, as a table, a picture and a text."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from machine_tool_calibration.interface.show import Answer, notebook
from machine_tool_calibration.methods.map_comparison import MapComparison as Compared
from machine_tool_calibration.plots.map_comparison import draw_map_comparison
from machine_tool_calibration.reports.map_comparison import map_comparison_document, show_map_comparison
from machine_tool_calibration.session.provenance import Provenance

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

__all__ = ["MapComparison"]


@dataclass(frozen=True, eq=False, repr=False)
class MapComparison(Answer[Compared]):
    """Whether two measurements of one machine agree within their joint uncertainty.

    Attributes:
        origins: what the maps were made from.
    """

    origins: tuple[Provenance, ...] = ()

    @property
    def agree(self) -> bool:
        """By the p-value of all differences together."""
        return self.found.agree

    @property
    def p_value(self) -> float | None:
        """Of all differences together; None where there are too many for it."""
        return self.found.p_value

    @cached_property
    def table(self) -> pd.DataFrame:
        """One component a row: x, y, z of the place and the direction; m.

        Columns: `first`, `second`, their `difference` with its standard uncertainty `u`, and `normalised`, the
        difference over its expanded uncertainty (E_n).
        """
        k, j = np.nonzero(np.isfinite(self.found.difference))
        columns = {name: getattr(self.found, name)[k, j] for name in _COLUMNS}
        places = [*self.found.points[k].T, np.array(list("xyz"))[j]]
        return pd.DataFrame(columns, pd.MultiIndex.from_arrays(places, names=["x", "y", "z", "direction"]))

    @property
    def headline(self) -> str:
        """What it is, in one line."""
        verdict = "agree" if self.agree else "contradict each other"
        return f"{' and '.join(self.found.labels)} {verdict} at {len(self.found.points)} points"

    def show(self, screen: Console, /) -> None:
        """Print what `mtcal compare-maps` prints."""
        show_map_comparison(screen, self.found)

    def plot(self) -> Figure:
        """Both maps, and the normalised differences."""
        return notebook(draw_map_comparison(self.found))

    @cached_property
    def _document(self) -> dict[str, Any]:
        return {**map_comparison_document(self.found), "provenance": [one.document() for one in self.origins]}


_COLUMNS = ("first", "second", "difference", "u", "normalised")
