# SPDX-License-Identifier: Apache-2.0
"""What was found, value by value, and the figures of ISO 230-2, ISO 230-6 and ISO 230-7 as a test report has them."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from machine_tool_calibration.coverage import K
from machine_tool_calibration.methods.identify import JointResult
from machine_tool_calibration.methods.iso230_2 import counted_positions
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.reports.quantities import (
    NOT_DETERMINED,
    decimals,
    fixed,
    micrometres,
    plus_minus,
    with_expanded,
)
from machine_tool_calibration.reports.result_tables import error_map, error_motions, workpiece
from machine_tool_calibration.reports.tables import Part, TextTable, heads, shortened
from machine_tool_calibration.words import say, together

STANDARDS = ("iso230_2", "iso230_6", "iso230_7", "figures")
"""Entries of an error map that hold figures of a standard."""
_RUNS = 5  # runs in each direction that ISO 230-2:2014 asks for
# Figures of ISO 230-2:2014 in the order of its test report; up and down, then both.
_FIGURES = (
    ("reversal_B", ("", "", "B")), ("mean_reversal", ("", "", "B_mean")),
    ("repeatability", ("R_up", "R_down", "R")), ("systematic", ("E_up", "E_down", "E")),
    ("mean_range", ("", "", "M")), ("accuracy", ("A_up", "A_down", "A")),
)  # fmt: skip
_BOTH = ("figure", "up", "down", "both")
_DIAGONAL = (("systematic_D", ("E_D_up", "E_D_down", "E_D")), ("reversal_D", ("", "", "B_D")))


def standard_tables(content: Mapping[str, Any], name: str, most: int | None = None) -> Iterator[Part]:
    """Tables and sentences of one of `STANDARDS`, in the order in which they are read; none where it has no figures."""
    if not (found := content.get(name)):
        return
    if name == "iso230_2":
        for run in found:
            yield _figures(run)
            yield _positions(run, most)
    elif name == "iso230_6":
        yield from _diagonals(found)
    elif name == "figures":
        yield _figures_of_method(found)
    else:
        yield _rotary(found, content.get("axis_average_line") or {})


def standard_rows(content: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """What the runs by ISO 230-2 come to, a line for each."""
    for run in content.get("iso230_2") or ():
        figures = [(name, _said(run.get(name), run.get(f"{name}_U"))) for name in ("A", "E", "R", "B")]
        told = ", ".join(f"{name} {text}" for name, text in figures if text != NOT_DETERMINED)
        if told:
            yield say("iso230.in_short", axis=run["axis"], setup=run["setup"]), f"{told} µm"


def _said(value: float | None, expanded: float | None) -> str:
    """A figure, um or urad, with its U (95 %) where there is one, which says how many digits it has."""
    if value is None or not np.isfinite(value):
        return NOT_DETERMINED
    if expanded is None or not np.isfinite(expanded) or not expanded:
        return micrometres(value)
    return " ± ".join(with_expanded(value, expanded))


def _cells(entry: Mapping[str, Any], names: Sequence[str]) -> tuple[str, ...]:
    return tuple(_said(entry.get(name), entry.get(f"{name}_U")) if name else "" for name in names)


def _figure_rows(entry: Mapping[str, Any], figures: Sequence[tuple[str, Sequence[str]]]) -> tuple[tuple[str, ...], ...]:
    rows = ((say(f"iso230.{name}"), *_cells(entry, names)) for name, names in figures)
    return tuple(row for row in rows if any(text not in ("", NOT_DETERMINED) for text in row[1:]))


def _figures(run: Mapping[str, Any]) -> TextTable:
    both = np.array([run["count_up"], run["count_down"]])
    counted = counted_positions(*both)
    counts = both[:, counted].min(axis=1).tolist()
    own = {"axis": run["axis"], "setup": run["setup"], "n": int(counted.sum())}
    title = say("iso230.run", **own, up=counts[0], down=counts[1])
    notes = [say("iso230.repeatability_only")] if run.get("note") else []
    if not counted.all():
        notes.append(say("iso230.turned"))
    if min(counts) < _RUNS:
        notes.append(say("iso230.one_run" if max(counts) < 2 else "iso230.few_runs", n=_RUNS))
    return TextTable(title, heads(*_BOTH), _figure_rows(run, _FIGURES), together(notes, "; "))


def _figures_of_method(found: Sequence[Mapping[str, Any]]) -> TextTable:
    rows = tuple((one["setup"], one["name"], _said(one["value"], one["U"]), f"µ{one['unit']}") for one in found)
    standards = together(dict.fromkeys(one["standard"] for one in found), ", ")
    return TextTable(say("iso230.figures", standards=standards), heads("setup", "figure", "value", "unit"), rows)


def _positions(run: Mapping[str, Any], most: int | None) -> TextTable:
    """Means, standard deviations and reversal at every position, with as many digits as their uncertainty allows."""
    s = np.array([run["s_up"], run["s_down"]], dtype=float)
    n = np.array([run["count_up"], run["count_down"]], dtype=float)
    least = 2e6 * s / np.sqrt(np.maximum(n, 1.0))
    known = least[np.isfinite(least) & (least > 0.0)]
    places = decimals(float(np.median(known))) if len(known) else 2
    up, down = (np.array(run[f"mean_{way}"], dtype=float) for way in ("up", "down"))
    values = [up, down, (up + down) / 2.0, np.array(run["reversal"], dtype=float), *s]
    rows = [
        (f"{1e3 * at:.6g}", *(fixed(1e6 * v, places) if np.isfinite(v) else NOT_DETERMINED for v in own))
        for at, *own in zip(run["position"], *values, strict=True)
    ]
    columns = (f"{run['axis']} / mm", *heads("mean_up", "mean_down", "mean", "reversal"), "s ↑", "s ↓")
    return TextTable(say("iso230.positions", axis=run["axis"]), columns, shortened(rows, most))


def _diagonals(found: Mapping[str, Any]) -> Iterator[TextTable]:
    for test in found["tests"]:
        kind = "body" if test["diagonals"] == "body" else "face"
        title = say(f"iso230.{kind}", plane=test["diagonals"], measured=test["measured"], of=test["of"])
        one_way = test["B_D"] is None or not np.isfinite(test["B_D"])
        yield TextTable(title, heads(*_BOTH), _figure_rows(test, _DIAGONAL), say("iso230.one_way") if one_way else "")
    rows = tuple(
        (run["setup"], run["axis"], str(max([*run["count_up"], *run["count_down"]])),
         *_cells(run, ("E_up", "E_down", "E", "B")))
        for run in found["runs"]
    )  # fmt: skip
    columns = (*heads("setup", "diagonal", "runs"), "E ↑", "E ↓", "E", "B")
    yield TextTable(say("iso230.diagonals"), columns, rows, say("iso230.letters"))


def _rotary(found: Sequence[Mapping[str, Any]], line: Mapping[str, Any]) -> TextTable:
    rows = []
    for one in found:
        kind, value = say(f"iso230.{one['kind'].replace(' ', '_')}"), _said(one["value"], one["U"])
        rows.append((kind, one["motion"], value, f"µ{one['unit']}", str(one["angles"])))
    for name in (name for name in line if f"{name}_u" in line):
        u = line[f"{name}_u"]
        shown = _said(line[name], None if u is None else K * u)
        rows.append((say("iso230.axis_average_line"), name, shown, "µm" if name[0] in "XYZ" else "µrad", ""))
    columns = heads("", "error_motion", "value", "unit", "angles")
    return TextTable(say("iso230.rotary"), columns, tuple(rows), say("iso230.synchronous"))


_DATUM = 1e-12  # standard uncertainty, m or rad, below which nothing but the datum gave a value


def value_tables(result: Result | JointResult, most: int | None = None) -> Iterator[TextTable]:
    """Error motions, an axis a table; the map where the model has none or it depends on the approach; a part's points.

    Every value with its expanded uncertainty U (95 %), which says how many digits it has.
    """
    motions = error_motions(result)
    known = motions[motions["determined"].astype(bool) & motions["position"].notna()]
    curves = motions[motions["motion"].isin(known["motion"]) & motions["position"].notna()]
    for axis, own in curves.groupby(curves["motion"].str[2], sort=False):
        yield _over_axis(str(axis), own, most)
    places = error_map(result)
    determined = [axis for axis in "xyz" if places[f"determined_{axis}"].any()]
    if determined and (curves.empty or {"approach", "row"} & {*places}):
        yield _map(places, determined, most)
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


def _map(table: pd.DataFrame, seen: Sequence[str], most: int | None) -> TextTable:
    """Position errors along the axes seen, one place a row, with the direction of approach where they depend on it."""
    own = [name for name in ("axis", "target", "approach", "row") if name in table]
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
