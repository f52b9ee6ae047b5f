"""What `mtcal identify` tells people: the result document in words, micrometres and microradians."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.cli.diagnosing import show_table
from machine_tool_calibration.model.model import Kind
from machine_tool_calibration.reports.quantities import TextTable, spread_words
from machine_tool_calibration.reports.unknowns import unknown_in_words

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from machine_tool_calibration.model.fit import JointFit
    from machine_tool_calibration.model.model import Parameter
    from machine_tool_calibration.session.session import Session

__all__ = [
    "direct_tables",
    "figures",
    "grouped",
    "measured",
    "scatter_words",
    "show_result",
    "shown",
    "verdict",
]


# Chance of the residuals below which the model is in doubt.
_DOUBTFUL = 0.01
_PUBLISHED = ("x", "y", "z", "workpiece_error", "workpiece_form")
_MOTION = re.compile(r"E[XYZABC][XYZABC]")


def figures(document: dict[str, Any]) -> list[tuple[str, str]]:
    """What the result of a session says, in words and micrometres."""
    rows = [
        ("readings used", f"{document['used']} of {document['observations']}"),
        ("RMS residual", f"{document['rms_residual'] * 1e6:.3f} µm"),
    ]
    chi = document.get("reduced_chi_square")
    if chi is not None:
        rows.append(("reduced chi-square", f"{chi:.2f} (1 if the model and the declared uncertainty are right)"))
    error_map = document.get("error_map") or {}
    error, uncertainty = _array(error_map.get("position_error")), _array(error_map.get("position_error_u"))
    if error.size:
        rows.append(("points of the map", _points(error_map.get("points"), len(error))))
        known = np.isfinite(error).any()
        text = f"{_rms(error):.2f} µm RMS, {_largest(error):.2f} µm at most" if known else "not determined"
        rows.append(("error of position", text + (_lost(error) if known else "")))
    if np.isfinite(uncertainty).any():
        rows.append(
            (
                "its uncertainty U (k = 2)",
                f"{2 * _rms(uncertainty):.2f} µm RMS, {2 * _largest(uncertainty):.2f} µm at most{_if_right(document)}",
            )
        )
    rows += _motions(error_map)
    missing = document.get("not_determined") or []
    if missing:
        names = ", ".join(entry["name"] for entry in missing[:6])
        rows.append(("not determined", f"{names}{' …' if len(missing) > 6 else ''}"))
    return rows


def _lost(error: np.ndarray) -> str:
    """Directions in which no point has a value."""
    lost = [axis for axis, known in zip("xyz", np.isfinite(error).any(axis=0), strict=False) if not known]
    return f"; not determined along {', '.join(lost)}" if lost else ""


def _points(points: Any, count: int) -> str:
    """How many, and why one place may be there more than once."""
    places = len({tuple(point) for point in points}) if points else count
    if places == count:
        return str(count)
    return f"{count}, at {places} places: a place counts once for each direction of approach that an effect tells apart"


def _motions(content: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Largest value and uncertainty of what a map holds beside positions."""
    out = []
    for name, value in content.items():
        known = name in _PUBLISHED or _MOTION.fullmatch(name)
        if not known or f"{name}_u" not in content or not isinstance(value, list):
            continue
        found, u = (np.array(content[key], dtype=float).reshape(-1) for key in (name, f"{name}_u"))
        good = np.isfinite(found)
        title = f"errors of {name.upper()}" if name in ("x", "y", "z") else name.replace("_", " ")
        if not good.any():
            out.append((title, "not determined"))
            continue
        unit = "µrad" if _MOTION.fullmatch(name) and name[1] in "ABC" else "µm"
        text = (
            f"{1e6 * np.abs(found[good]).max():.2f} {unit} at most, U (k = 2) at most {2e6 * u[good].max():.2f} {unit}"
        )
        out.append((title, text + ("" if good.all() else f"; {int((~good).sum())} of {len(good)} not determined")))
    return out


def _if_right(document: dict[str, Any]) -> str:
    """A warning where the readings speak against the model on which the uncertainty rests."""
    p = document.get("p_value")
    return ", if the model were right" if p is not None and p < _DOUBTFUL else ""


def _array(value: Any) -> np.ndarray:
    return np.array(value, dtype=float) if value else np.zeros((0, 3))


def _rms(vectors: np.ndarray) -> float:
    """Root mean square length of the vectors of which anything is known, micrometres."""
    known = vectors[np.isfinite(vectors).any(axis=1)]
    return float(np.sqrt(np.mean(np.nansum(known**2, axis=1)))) * 1e6


def _largest(vectors: np.ndarray) -> float:
    """Greatest length of a vector, micrometres."""
    return float(np.sqrt(np.max(np.nansum(vectors**2, axis=1)))) * 1e6


# Chance below which a step or a parameter counts as significant.
_SIGNIFICANT = 0.01
_MOST_ROWS = 12
# Runs in each direction that ISO 230-2:2014 asks for.
_RUNS = 5
# Figures of ISO 230-2:2014 in the order of a test report; up and down, then both.
_FIGURES = (
    ("B", "reversal error B", ("", "", "B")),
    ("B_mean", "mean reversal error", ("", "", "B_mean")),
    ("R", "repeatability R", ("R_up", "R_down", "R")),
    ("E", "systematic deviation E", ("E_up", "E_down", "E")),
    ("M", "mean deviation, range M", ("", "", "M")),
    ("A", "accuracy A", ("A_up", "A_down", "A")),
)


def scatter_words(content: Mapping[str, Any], p_value: float) -> str | None:
    """How the readings scatter, what was declared, and which of them the uncertainties use; None for other methods."""
    scatter = content.get("scatter")
    if scatter is None or scatter["found"] is None:
        return None
    found, declared = 1e6 * scatter["found"], 1e6 * scatter["declared"]
    both = f"scatter {_three(found)} µm, declared {_three(declared)} µm"
    if scatter["uncertainties_from"] == "scatter":
        return (
            f"The readings scatter {scatter['factor']:.1f} times their declared uncertainty about the model ({both}): "
            "standard uncertainties use the scatter. Whether something is missing in the model, `mtcal diagnose` says."
        )
    if p_value is not None and p_value > 1 - 1e-3:
        return (
            f"The readings scatter less than declared about the model ({both}): standard uncertainties use what was "
            f"declared; from the scatter alone they would be {_three(found / declared)} times as large."
        )
    return f"The model fits the readings within their declared uncertainty ({both}): standard uncertainties use it."


def direct_tables(content: Mapping[str, Any]) -> Iterator[Table | TextTable | str]:
    """Tables and sentences, in the order in which they are read."""
    plate = content.get("plate")
    if plate:
        yield _plate_table(plate)
        yield from _plate_words(plate)
    for run in content.get("iso230_2") or ():
        yield _run_table(run)


def _plate_table(plate: Mapping[str, Any]) -> Table:
    table = _plate_heads(
        f"step by step, over {plate['places']} deviations (sizes ± U, k = 2, from the scatter that is left)",
        ("model", "unknowns", "RMS / µm", "scatter / µm", "p of the step", "sizes"),
    )
    for step in plate["steps"]:
        table.add_row(
            step["model"],
            str(step["unknowns"]),
            f"{1e6 * step['rms']:.3f}",
            f"{1e6 * step['scatter']:.3f}",
            _chance(step["p_value"]) if "p_value" in step else "",
            "\n".join(_size(p) for p in step["parameters"]),
        )
    return table


def _plate_words(plate: Mapping[str, Any]) -> Iterator[str]:
    steps = plate["steps"]
    told = [p for step in steps[1:3] for p in step["parameters"] if p["value"] is not None]
    good = [p["name"].split(".")[0] if "-" not in p["name"] else _plain(p["name"]) for p in told if _is(p)]
    not_good = [p["name"].split(".")[0] if "-" not in p["name"] else _plain(p["name"]) for p in told if not _is(p)]
    words = []
    if good:
        words.append(f"Significant (p < {_SIGNIFICANT}): {', '.join(good)}.")
    if not_good:
        words.append(f"Not significant: {', '.join(not_good)}.")
    if len(steps) > 3:
        more = "significant" if steps[3]["p_value"] < _SIGNIFICANT else "not significant"
        fell = 1e6 * (steps[2]["scatter"] - steps[3]["scatter"])
        words.append(f"Curves beyond that are {more}" + (f" (they take {fell:.2f} µm)." if fell > 0 else "."))
    yield " ".join(words)
    if plate["set_aside"]:
        rows = plate["set_aside"]
        shown = ", ".join(str(row) for row in rows[:_MOST_ROWS]) + (" …" if len(rows) > _MOST_ROWS else "")
        yield (
            f"Left out of these steps, but not of the fit: {'rows' if len(rows) > 1 else 'row'} {shown} (the first row "
            "is 0), far out of all others. `mtcal improve` sets them aside."
        )


def _run_table(run: Mapping[str, Any]) -> TextTable:
    counts = [min(run["count_up"] or [0]), min(run["count_down"] or [0])]
    rows = []
    for key, title, names in _FIGURES:
        texts = [_micro(run.get(name)) if name else "" for name in names]
        if any(text not in ("", "–") for text in texts):
            rows.append((title, *texts, _micro(run.get(f"{key}_U"))))
    title = (
        f"{run['axis']} by ISO 230-2: setup {run['setup']}, {len(run['position'])} positions, runs: {counts[0]} up, "
        f"{counts[1]} down (µm)"
    )
    notes = [run["note"].removesuffix(".")] if run.get("note") else []
    if min(counts) < _RUNS:
        notes.append(
            f"ISO 230-2 asks for {_RUNS} runs in each direction; with fewer the figures are for information, and "
            + ("repeatability and accuracy cannot be told" if max(counts) < 2 else "repeatability is uncertain")
        )
    return TextTable(title, ("figure", "up", "down", "both", "U (k = 2)"), tuple(rows), "; ".join(notes))


def _plate_heads(title: str, heads: Sequence[str]) -> Table:
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for k, head in enumerate(heads):
        table.add_column(head, justify="left" if k == 0 or head == "sizes" else "right")
    return table


def _is(parameter: Mapping[str, Any]) -> bool:
    return parameter["p_value"] is not None and parameter["p_value"] < _SIGNIFICANT


def _plain(name: str) -> str:
    return name.replace(".s", "").replace("-", "−")


def _size(parameter: Mapping[str, Any]) -> str:
    from machine_tool_calibration.reports.quantities import quantity

    name = _plain(parameter["name"].removesuffix(".angle"))
    if parameter["value"] is None:
        return f"{name} not determined"
    size = quantity(parameter["value"], parameter["unit"], parameter["standard_uncertainty"])
    return f"{name} = {size}" + ("" if _is(parameter) else " (not significant)")


def _chance(value: float) -> str:
    return "< 1e-12" if value < 1e-12 else f"{value:.1e}" if value < 1e-3 else f"{value:.3f}"


def _micro(value: float | None) -> str:
    return "–" if value is None else f"{1e6 * value:.2f}"


def _three(value: float) -> str:
    return f"{value:.3g}"


_MOST_ROWS_IDENTIFIED = 40
_MOST_NAMES = 8
_UNITS = {"m": (1e6, "µm"), "rad": (1e6, "µrad"), "m/s": (3.6e9, "µm/h"), "rad/s": (3.6e9, "µrad/h")}


def show_result(screen: Console, document: Mapping[str, Any], opened: Iterable[Session], fit: JointFit) -> None:
    """Print a result document.

    Args:
        screen: where.
        document: of the result.
        opened: the sessions that were identified.
        fit: behind it.
    """
    from rich.table import Table

    for session in opened:
        screen.print(measured(session))
    if document["effects"]:
        screen.print(f"model: {_variants(document)} with {', '.join(document['effects'])}")
    if document["averaged_over"]:
        over = (f"{' + '.join(one['effects'])} ({one['probability']:.2f})" for one in document["averaged_over"])
        screen.print(f"The map is the mean over effects that these readings do not tell apart: {', '.join(over)}.")
    screen.print(verdict(document))
    for words in spread_words(document["spread"]):
        screen.print(words)
    table = Table(show_header=False, box=None, pad_edge=False)
    for name, text in figures({**document, "not_determined": []}):
        table.add_row(name, text)
    screen.print(table)
    for shown_of_direct in direct_tables(document["error_map"]):
        if isinstance(shown_of_direct, TextTable):
            show_table(screen, shown_of_direct)
        else:
            screen.print(shown_of_direct)
    if "agreement" in document:
        screen.print(document["agreement"]["statement"])
    for reason, rows in grouped((str(entry["row"]), entry["reason"]) for entry in document["rejected"]):
        screen.print(f"not used: {'rows' if ',' in rows else 'row'} {rows} (the first row is 0): {reason}")
    _show_parameters(screen, document, fit)
    for why, names in grouped((entry["name"], entry["why"]) for entry in document["not_determined"]):
        screen.print(f"not determined: {names}: {why}")
    screen.print(f"datum: {document['datum']}")


def _variants(document: Mapping[str, Any]) -> str:
    """The method's variant, of several sessions each with its label."""
    if "sessions" not in document:
        return str(document["model"])
    return ", ".join(f"{entry['model']} ({entry['label']})" for entry in document["sessions"])


def measured(session: Session) -> str:
    """What was measured, in one line."""
    ids = session.setup_ids
    names = ", ".join(ids[:_MOST_NAMES]) + (" …" if len(ids) > _MOST_NAMES else "")
    words = session.spec.words
    kind = session.method.replace("_", " ") if words is None else words(session.description)
    repeats = len(np.unique(session.readings.repeat))
    return (
        f"{kind}: {len(session.readings)} readings in {len(ids)} setup{'s' if len(ids) > 1 else ''} ({names}), "
        f"{repeats} repeat{'s' if repeats > 1 else ''}, declared standard uncertainty {session.sigma * 1e6:.3g} µm"
    )


def verdict(document: Mapping[str, Any]) -> str:
    """How well the model fits, in plain words."""
    chi, p = document["reduced_chi_square"], document["p_value"]
    direct = scatter_words(document.get("error_map") or {}, p)
    if direct is not None:
        return direct
    ratio = chi**0.5
    if p < 1e-3:
        return (
            f"The readings scatter {ratio:.1f} times their declared uncertainty about the model "
            f"(p {'< 1e-12' if p < 1e-12 else f'= {p:.1g}'}): something is missing in it, or the declared uncertainty "
            "is too small. `mtcal diagnose` looks for it."
        )
    if p > 1 - 1e-3:
        return f"The readings scatter only {ratio:.2f} times their declared uncertainty: it is stated too large."
    if p < 0.05:
        return (
            f"The model fits the readings nearly within their declared uncertainty (p = {p:.2g}): something small may "
            "be missing in it. `mtcal diagnose` looks for it."
        )
    return f"The model fits the readings within their declared uncertainty (p = {p:.2g})."


def grouped(entries: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """From (name, reason) to each reason with the names that share it, the first ones by name."""
    names: dict[str, list[str]] = {}
    for name, reason in entries:
        names.setdefault(reason, []).append(name)
    return [
        (
            reason,
            ", ".join(own[:_MOST_NAMES]) + (f" and {len(own) - _MOST_NAMES} more" if len(own) > _MOST_NAMES else ""),
        )
        for reason, own in names.items()
    ]


def _show_parameters(screen: Console, document: Mapping[str, Any], fit: JointFit) -> None:
    unknowns = fit.assembly.unknowns
    single = [entry for entry in document["parameters"] if unknowns[entry["name"]].kind is not Kind.MOTION]
    # Effects first, then what is of the machine (squareness), then what is of the setups.
    order = {Kind.EFFECT: 0, Kind.SQUARENESS: 1}
    single.sort(key=lambda entry: order.get(unknowns[entry["name"]].kind, 2))
    rows = []
    for entry in single[:_MOST_ROWS_IDENTIFIED]:
        name = entry["name"]
        unknown = unknowns[name]
        place = unknown.kind in (Kind.PLACE, Kind.DEAD_PATH)
        what = unknown.meaning or unknown_in_words(unknown)
        texts = shown(entry["value"], entry["standard_uncertainty"], entry["unit"], place)
        rows.append((name, *texts, "" if what == name else what))
    if rows:
        left = len(single) - len(rows)
        note = f"{left} more; --json gives all of them" if left else ""
        heads = ("name", "value", "u (k = 1)", "U (k = 2)", "unit", "what it is")
        show_table(screen, TextTable("Parameters", heads, tuple(rows), note))
    _show_tables(screen, document, unknowns)


def _show_tables(screen: Console, document: Mapping[str, Any], unknowns: Mapping[str, Parameter]) -> None:
    """Each table of an error motion in one row; none of what is not determined."""
    lost = {entry["name"] for entry in document["not_determined"]}
    tables: dict[str, list[Mapping[str, Any]]] = {}
    for entry in document["parameters"]:
        unknown = unknowns[entry["name"]]
        if unknown.kind is Kind.MOTION and unknown.owner not in lost:
            tables.setdefault(unknown.family, []).append(entry)
    rows = []
    for name, own in tables.items():
        value, u = (1e6 * np.array([entry[key] for entry in own]) for key in ("value", "standard_uncertainty"))
        unit = "µrad" if own[0]["unit"] == "rad" else "µm"
        most = 2.0 * float(u.max())
        places = _places(most) if 1e-6 < most < 1e9 else 2
        texts = (_fixed(float(number), places) for number in (value.min(), value.max(), most))
        rows.append((name, str(len(own)), *texts, unit))
    if rows:
        heads = ("name", "values", "smallest", "largest", "U (k = 2) at most", "unit")
        show_table(screen, TextTable("Error motions", heads, tuple(rows), "--json gives every value"))


def shown(value: float, uncertainty: float, unit: str, place: bool = False) -> tuple[str, str, str, str]:
    """Value, u and U with as many digits as the uncertainty bears, and the unit that people use; a place is in mm."""
    factor, name = _UNITS.get(unit, (1.0, unit))
    if unit == "1" and max(abs(value), uncertainty) < 1e-3:
        factor, name = 1e6, "µm/m"
    if unit == "m" and (place or abs(value) > 1e-2):
        factor, name = 1e3, "mm"
    u = uncertainty * factor
    if 1e-9 < u < 1e7 and abs(value * factor) < 1e9:
        texts = tuple(_fixed(number, _places(u)) for number in (value * factor, u, 2 * u))
    else:
        texts = (f"{value * factor:.5g}", f"{u:.2g}", f"{2 * u:.2g}")
    return texts[0], texts[1], texts[2], "" if name == "1" else name


def _places(uncertainty: float) -> int:
    """Decimals that leave an uncertainty two figures."""
    return max(0, 1 - int(np.floor(np.log10(uncertainty))))


def _fixed(number: float, places: int) -> str:
    """So many decimals, and no minus sign before a zero."""
    return f"{round(number, places) + 0.0:.{places}f}"
