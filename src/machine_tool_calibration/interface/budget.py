# SPDX-License-Identifier: Apache-2.0
"""The uncertainty budget of a result, and whether the result conforms to tolerances."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pandas as pd

from machine_tool_calibration.budget.conformity import Conformity as Judged
from machine_tool_calibration.budget.propagate import Budget as Propagated
from machine_tool_calibration.interface.show import Answer, notebook
from machine_tool_calibration.plots.budget import draw_budget
from machine_tool_calibration.plots.style import Figure
from machine_tool_calibration.reports.budget import budget_document, budget_parts, conformity_document, conformity_parts
from machine_tool_calibration.reports.quantities import expanded_text
from machine_tool_calibration.reports.tables import Part


@dataclass(frozen=True, eq=False, repr=False)
class Budget(Answer, Propagated):
    """Who contributes what to the uncertainty of everything that was identified.

    Attributes:
        names: quantities that were asked for; empty for those that are told of every measurement.
    """

    names: tuple[str, ...] = ()

    @cached_property
    def contributors(self) -> pd.DataFrame:
        """The lines of the budget by name; SI.

        Columns: `symbol`, `type` (A or B), `distribution`, standard uncertainty `u` in `unit`, `degrees_of_freedom`,
        `enters`, `varies`, `source`, and `in_one_reading`, the largest standard uncertainty that it gives a reading, m.
        """
        frame = pd.DataFrame(self._document["contributors"]).rename(columns={"standard_uncertainty": "u"})
        return frame.set_index("name")

    @cached_property
    def quantities(self) -> pd.DataFrame:
        """Each quantity's combined uncertainty, one a row; SI.

        Columns: `name`, `which` (largest: the number of the quantity with the largest uncertainty, at `where`; rms:
        over all its numbers), `value`, combined standard uncertainty `u` and expanded uncertainty `U` in `unit`, with
        `degrees_of_freedom` (NaN: infinite) and `k`; `u_identification`, which the readings themselves show.
        """
        frame = pd.json_normalize(self._document["quantities"])
        numeric = dict.fromkeys(("value", "degrees_of_freedom", "u_identification"), float)
        return frame.reindex(columns=[*_QUANTITIES]).rename(columns=_QUANTITIES).astype(numeric)

    @cached_property
    def contributions(self) -> pd.DataFrame:
        """What each contributor gives to each quantity, one a row.

        Columns: `name` and `which` as in `quantities`, `contributor`, its standard uncertainty `u` in `unit` (SI), and
        `share`, its square over the sum of all squares.
        """
        rows = [
            (entry["name"], entry["which"], part["name"], part["standard_uncertainty"], entry["unit"], part["share"])
            for entry in self._document["quantities"]
            for part in entry["contributions"]
        ]
        return pd.DataFrame(rows, columns=["name", "which", "contributor", "u", "unit", "share"])

    @property
    def headline(self) -> str:
        """What it is, in one line."""
        count = f"{len(self.lines)} contributors"
        if not self._document["quantities"]:
            return f"uncertainty budget of {count}: nothing is determined"
        first = self._document["quantities"][0]
        most = max(first["contributions"], key=lambda part: part["share"])
        return (
            f"uncertainty budget of {count}: {first['name']}, U = "
            f"{expanded_text(first['expanded_uncertainty'], first['unit'])} at most, {100 * most['share']:.0f} % of it "
            f"from {most['name']}"
        )

    def parts(self) -> Iterator[Part]:
        """What `mtcal budget` prints."""
        return budget_parts(self, self.names)

    def plot(self) -> Figure:
        """The bar chart of `mtcal budget --plot`, a figure that no window shows; a notebook does."""
        return notebook(draw_budget(self, self.names))

    @cached_property
    def _document(self) -> dict[str, Any]:
        return budget_document(self, self.names)


_QUANTITIES = {
    **{name: name for name in ("name", "which", "where", "value")},
    **{"standard_uncertainty": "u", "expanded_uncertainty": "U", "unit": "unit"},
    **{"effective_degrees_of_freedom": "degrees_of_freedom", "coverage_factor": "k"},
    "identification.standard_uncertainty": "u_identification",
}
"""Columns of the quantities by their keys in the document."""


@dataclass(frozen=True, eq=False, repr=False)
class Conformity(Answer, Judged):
    """Whether tolerances are kept, and how sure that is."""

    @cached_property
    def verdicts(self) -> pd.DataFrame:
        """One tolerance a row, by the figure's name; SI.

        Columns: `tolerance`, `value` with standard uncertainty `u` in `unit`, `probability` that the true value lies
        within the tolerance, `decision` (pass, fail, undecided, not determined) and `why` it is not determined.
        """
        columns = ["tolerance", "value", "u", "unit", "probability", "decision", "why"]
        rows = [[v.name, *(getattr(v, name) for name in columns)] for v in self.each]
        return pd.DataFrame(rows, columns=["name", *columns]).set_index("name")

    @property
    def headline(self) -> str:
        """What it is, in one line."""
        told = ", ".join(f"{v.name} {v.decision}" for v in self.each)
        return f"conformity: {self.decision} ({told})"

    def parts(self) -> Iterator[Part]:
        """What `mtcal conformity` prints."""
        return conformity_parts(self)

    _document = cached_property(conformity_document)
