# SPDX-License-Identifier: Apache-2.0
"""Two maps of one machine held against each other, as a table, a picture and a text."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from machine_tool_calibration.interface.show import Answer, notebook
from machine_tool_calibration.methods.map_comparison import BY_CHANCE, OPEN_LEVEL
from machine_tool_calibration.methods.map_comparison import MapComparison as Compared
from machine_tool_calibration.plots.maps import draw_map_comparison
from machine_tool_calibration.plots.style import Figure
from machine_tool_calibration.reports.documents import picked
from machine_tool_calibration.reports.quantities import ROUNDING, p_value, plus_minus, quantity, rounded
from machine_tool_calibration.reports.tables import Part, TextTable
from machine_tool_calibration.session.provenance import Provenance

_MOST_POINTS = 25  # points of a table for people: of more, those of which the maps differ most
_COLUMNS = ("first", "second", "difference", "u", "normalised")


@dataclass(frozen=True, eq=False, repr=False)
class MapComparison(Answer, Compared):
    """Whether two measurements of one machine agree within their joint uncertainty.

    Attributes:
        origins: what the maps were made from.
    """

    origins: tuple[Provenance, ...] = ()

    @cached_property
    def table(self) -> pd.DataFrame:
        """One component a row: x, y, z of the place and the direction; m.

        Columns: `first`, `second`, their `difference` with its standard uncertainty `u`, and `normalised`, the
        difference over its expanded uncertainty (E_n).
        """
        k, j = np.nonzero(np.isfinite(self.difference))
        columns = {name: getattr(self, name)[k, j] for name in _COLUMNS}
        places = [*self.points[k].T, np.array(list("xyz"))[j]]
        return pd.DataFrame(columns, pd.MultiIndex.from_arrays(places, names=["x", "y", "z", "direction"]))

    @property
    def headline(self) -> str:
        """What it is, in one line."""
        verdict = "agree" if self.agree else "contradict each other"
        return f"{' and '.join(self.labels)} {verdict} at {len(self.points)} points"

    def parts(self) -> Iterator[Part]:
        """The differences, the motion between the datums and the verdict."""
        yield _differences(self)
        known = [m for m in self.motion if np.isfinite(m.value) and max(abs(m.value), m.u) > ROUNDING]
        if moved := [f"{m.name} {quantity(m.value, m.unit, m.u)}" for m in known]:
            yield f"Taken out before, as the datums differ by it: {', '.join(moved)}."
        else:
            yield "Both maps have the same datum at these points: there is no common motion to take out."
        if any(self.alone):
            yield (
                f"Not compared: {self.alone[0]} points that only {self.labels[0]} has, and {self.alone[1]} that only "
                f"{self.labels[1]} has. Points that differ by more than 1 µm are two."
            )
        yield _verdict(self)

    def plot(self) -> Figure:
        """Both maps, and the normalised differences."""
        return notebook(draw_map_comparison(self))

    @cached_property
    def _document(self) -> dict[str, Any]:
        return {
            "format": "mtcal-map-comparison/1",
            "maps": list(self.labels),
            "agree": self.agree,
            "p_value": self.p_value,
            "compared": self.count,
            "beyond_1": self.beyond,
            "not_compared": self.alone,
            "motion": [asdict(m) for m in self.motion],
            **picked(self, "points", "first", "second", "difference", "normalised"),
            "first_u": self.u_first,
            "second_u": self.u_second,
            "difference_u": self.u,
            "provenance": [one.document() for one in self.origins],
        }


def _verdict(comparison: Compared) -> str:
    """Whether the maps agree, and where they differ most."""
    size = np.abs(comparison.normalised)
    k, j = np.unravel_index(int(np.nanargmax(size)), size.shape)
    place = ", ".join(f"{1e3 * v:.6g}" for v in comparison.points[k])
    verdict, chance = "The maps agree within their joint uncertainty", BY_CHANCE * comparison.count
    if not comparison.agree:
        verdict = "The maps contradict each other: they differ by more than their joint uncertainty"
    elif comparison.p_value is not None and comparison.p_value < OPEN_LEVEL:
        verdict = "Whether the maps agree is open: they differ by more than their joint uncertainty mostly explains"
    together = "" if comparison.p_value is None else f"; all differences together have {p_value(comparison.p_value)}"
    more = ", in the mean: what they have in common moves many at once" if comparison.beyond > chance else ""
    told = [
        f"{verdict}. The largest normalised difference is E_n = {comparison.normalised[k, j]:+.2f}, "
        f"along {'xyz'[j]} at ({place}) mm; {comparison.beyond} of {comparison.count} exceed 1, of which chance makes "
        f"{chance:.1f}{more}{together}."
    ]
    told += [
        f"The readings of {label} scatter {rounded(ratio)} times as much as declared about its model, and U contains "
        "that: what the model may lack (`mtcal diagnose`) hides in it."
        for label, ratio in zip(comparison.labels, comparison.scatter, strict=True)
        if ratio > 1.0
    ]
    return " ".join(told)


def _differences(comparison: Compared) -> TextTable:
    """The differences point by point; of many points those with the largest normalised ones."""
    told = np.isfinite(comparison.difference)
    axes = np.flatnonzero(told.any(axis=0))
    order = np.flatnonzero(told.any(axis=1))
    note = (
        "± U (95 %), without instrument and temperature; E_n is the difference over its U; "
        f"1 is {comparison.labels[0]}, 2 is {comparison.labels[1]}"
    )
    if len(order) > _MOST_POINTS:
        worst = np.nanmax(np.abs(comparison.normalised[order]), axis=1)
        note += f"; the {_MOST_POINTS} of {len(order)} points that differ most, all with --json"
        order = np.sort(order[np.argsort(-worst, kind="stable")[:_MOST_POINTS]])
    heads = ["x, y, z / mm"]
    for j in axes:
        heads += [f"{'xyz'[j]}: 1 / µm", "2 / µm", "1 − 2 / µm", "E_n"]
    rows = []
    for k in order:
        row = [", ".join(f"{1e3 * v:.6g}" for v in comparison.points[k])]
        for j in axes:
            if told[k, j]:
                row += [
                    _own(comparison.first[k, j], comparison.u_first[k, j]),
                    _own(comparison.second[k, j], comparison.u_second[k, j]),
                    plus_minus(float(comparison.difference[k, j]), float(comparison.u[k, j]), 1e6),
                    f"{comparison.normalised[k, j]:+.2f}",
                ]
            else:
                row += [""] * 4
        rows.append(tuple(row))
    return TextTable("Position errors by both maps", tuple(heads), tuple(rows), note)


def _own(value: float, u: float) -> str:
    """An error by one of the maps, in micrometres, with as many digits as its own U allows."""
    return plus_minus(float(value), float(u), 1e6).partition(" ± ")[0]
