# SPDX-License-Identifier: Apache-2.0
"""Two maps of one machine held against each other, as a table, a picture and a text."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from machine_tool_calibration.interface.show import Shown, notebook, printed
from machine_tool_calibration.methods.map_comparison import MapComparison as Compared

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["MapComparison"]


@dataclass(frozen=True, eq=False, repr=False)
class MapComparison(Shown):
    """Whether two measurements of one machine agree within their joint uncertainty.

    Attributes:
        compared: all that was calculated, as the package itself uses it.
    """

    compared: Compared

    @property
    def agree(self) -> bool:
        """By the p-value of all differences together."""
        return self.compared.agree

    @property
    def p_value(self) -> float | None:
        """Of all differences together; None where there are too many for it."""
        return self.compared.p_value

    @cached_property
    def table(self) -> pd.DataFrame:
        """One component a row: x, y, z of the place and the direction; m.

        Columns: `first`, `second`, their `difference` with its standard uncertainty `u`, and `normalised`, the
        difference over its expanded uncertainty (E_n).
        """
        found = self.compared
        k, j = np.nonzero(np.isfinite(found.difference))
        columns = {
            "first": found.first[k, j],
            "second": found.second[k, j],
            "difference": found.difference[k, j],
            "u": found.u[k, j],
            "normalised": found.normalised[k, j],
        }
        places = [*found.points[k].T, np.array(list("xyz"))[j]]
        return pd.DataFrame(columns, pd.MultiIndex.from_arrays(places, names=["x", "y", "z", "direction"]))

    @property
    def headline(self) -> str:
        """What it is, in one line."""
        verdict = "agree" if self.agree else "contradict each other"
        return f"{' and '.join(self.compared.labels)} {verdict} at {len(self.compared.points)} points"

    def report(self) -> str:
        """What `mtcal compare-maps` prints."""
        from machine_tool_calibration.reports.map_comparison import show_map_comparison

        return printed(lambda screen: show_map_comparison(screen, self.compared))

    def document(self) -> dict[str, Any]:
        """The same for programs, as `mtcal compare-maps --json` writes it (`mtcal-map-comparison/1`)."""
        from machine_tool_calibration.reports.map_comparison import map_comparison_document

        return map_comparison_document(self.compared)

    def plot(self) -> Figure:
        """Both maps, and the normalised differences."""
        from machine_tool_calibration.plots.map_comparison import draw_map_comparison

        return notebook(draw_map_comparison(self.compared))
