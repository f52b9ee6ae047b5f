# SPDX-License-Identifier: Apache-2.0
"""What was found, value by value: error motions over their axes, the map place by place, a part point by point."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from machine_tool_calibration.methods.identify import JointResult
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.reports.quantities import NOT_DETERMINED, micrometres, plus_minus
from machine_tool_calibration.reports.result_tables import error_map, error_motions, workpiece
from machine_tool_calibration.reports.tables import TextTable, heads, shortened
from machine_tool_calibration.words import say

__all__ = ["value_tables"]

# Standard uncertainty, m or rad, below which nothing but the datum gave a value.
_DATUM = 1e-12


def value_tables(result: Result | JointResult, most: int | None = None) -> Iterator[TextTable]:
    """Error motions, an axis a table; the map where the model has none or it depends on the approach; a part's points.

    Every value with its expanded uncertainty U (k = 2), which says how many digits it has.

    Args:
        result: of an identification.
        most: rows of a table; None for all.
    """
    motions = error_motions(result)
    known = motions[motions["determined"].astype(bool) & motions["position"].notna()]
    curves = motions[motions["motion"].isin(known["motion"]) & motions["position"].notna()]
    for axis, own in curves.groupby(curves["motion"].str[2], sort=False):
        yield _over_axis(str(axis), own, most)
    places = error_map(result)
    if curves.empty or "approach" in places:
        yield _map(places, most)
    part = workpiece(result).reset_index()
    if len(part):
        rows = [
            (str(r["point"]), _mm(r["x"]), _mm(r["y"]), _known(r["error"], r["u"]), _known(r["form"], r["u_form"]))
            for r in part.to_dict("records")
        ]
        columns = (*heads("point"), "x / mm", "y / mm", *heads("error_um", "form_um"))
        yield _titled(say("result.part"), columns, rows, most)


def _titled(title: str, columns: tuple[str, ...], rows: Sequence[tuple[str, ...]], most: int | None) -> TextTable:
    shown = shortened(rows, most)
    note = "" if len(shown) == len(rows) else say("text.more_with_csv", n=len(rows) - len(shown) + 1)
    return TextTable(title, columns, shown, note)


def _over_axis(axis: str, table: pd.DataFrame, most: int | None) -> TextTable:
    """All error motions of an axis, one position a row."""
    turned = table["position_unit"].iloc[0] == "rad"
    names = list(dict.fromkeys(table["motion"]))
    by_place: dict[float, dict[str, str]] = {}
    for row in table.to_dict("records"):
        place = round(float(np.degrees(row["position"]) if turned else 1e3 * row["position"]), 6) + 0.0
        by_place.setdefault(place, {})[row["motion"]] = _known(row["value"], row["u"])
    rows = [(f"{place:.6g}", *(values.get(n, "") for n in names)) for place, values in sorted(by_place.items())]
    unit = dict(zip(table["motion"], table["unit"], strict=True))
    columns = (f"{axis} / {'°' if turned else 'mm'}", *(f"{name} / µ{unit[name]}" for name in names))
    return _titled(say("result.motions_of", axis=axis), columns, rows, most)


def _map(table: pd.DataFrame, most: int | None) -> TextTable:
    """Position errors, one place a row, with the direction of approach where they depend on it."""
    own = [name for name in ("axis", "target", "approach") if name in table]
    seen = [axis for axis in "xyz" if table[f"determined_{axis}"].any()] or ["x"]
    rows = [
        (
            *(_mm(row[axis]) for axis in "xyz"),
            *(str(row[name]) for name in own),
            *(_known(row[f"e{axis}"], row[f"u{axis}"]) for axis in seen),
        )
        for row in table.to_dict("records")
    ]
    columns = ("x / mm", "y / mm", "z / mm", *heads(*own), *(f"e{axis} / µm" for axis in seen))
    return _titled(say("result.position_errors"), columns, rows, most)


def _mm(metres: float) -> str:
    return f"{round(1e3 * metres, 3) + 0.0:.6g}" if np.isfinite(metres) else NOT_DETERMINED


def _known(value: float, u: float) -> str:
    if not np.isfinite(value):
        return NOT_DETERMINED
    return micrometres(value, signed=True) if u < _DATUM else plus_minus(value, u, 1e6)
