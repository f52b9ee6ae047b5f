# SPDX-License-Identifier: Apache-2.0
"""What `mtcal identify` tells people: the result document in words, micrometres and microradians."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence, Set
from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.machine.error_motions import ERROR_MOTIONS, SQUARENESS, parse_motion
from machine_tool_calibration.model.model import Kind
from machine_tool_calibration.reports.direct_deviations import direct_tables, scatter_words
from machine_tool_calibration.reports.quantities import (
    NOT_DETERMINED,
    decimals,
    declared_words,
    fixed,
    micrometres,
    not_ruled_out,
    p_value,
    quantity,
    reproducibility_words,
    rounded,
    value_and_uncertainties,
)
from machine_tool_calibration.reports.signs import negative_words
from machine_tool_calibration.reports.tables import TextTable, show_suspicions, show_table
from machine_tool_calibration.reports.unknowns import unknown_in_words

if TYPE_CHECKING:
    from rich.console import Console

    from machine_tool_calibration.model.fit import JointFit
    from machine_tool_calibration.model.model import Parameter
    from machine_tool_calibration.session.session import Session

__all__ = [
    "datum_words",
    "goodness_of_fit",
    "group_by_reason",
    "motion_row",
    "readings_set_aside",
    "session_headline",
    "show_profiles",
    "show_result",
    "summary_rows",
]


# p-value of the residuals below which the model is in doubt.
_DOUBTFUL = 0.01
# U, µm or µrad, below which nothing but the datum gave a value.
_DATUM = 1e-6
_PUBLISHED = ("x", "y", "z", "workpiece_error", "workpiece_form")


def summary_rows(document: dict[str, Any]) -> list[tuple[str, str]]:
    """What the result of a session says, in words and micrometres."""
    rows = [
        ("readings used", f"{document['used']} of {document['observations']}"),
        ("RMS residual", quantity(document["rms_residual"], "m")),
    ]
    chi = document.get("reduced_chi_square")
    if chi is not None:
        rows.append(("reduced chi-square", f"{rounded(chi)} (1 if the model and the declared uncertainty are right)"))
    error_map = document.get("error_map") or {}
    error, uncertainty = _array(error_map.get("position_error")), _array(error_map.get("position_error_u"))
    if error.size:
        rows.append(("points of the map", _points(error_map.get("points"), len(error))))
        text = "not determined"
        if np.isfinite(error).any():
            text = f"{quantity(_rms(error), 'm')} RMS, {quantity(_largest(error), 'm')} at most{_lost(error)}"
        rows.append(("position error", text))
    if np.isfinite(uncertainty).any():
        rows.append(
            (
                "its uncertainty U (k = 2)",
                f"{quantity(2 * _rms(uncertainty), 'm')} RMS, {quantity(2 * _largest(uncertainty), 'm')} at most"
                f"{_if_right(document)}",
            )
        )
    rows += _motions(error_map)
    missing = document.get("not_determined") or []
    if missing:
        names = ", ".join(entry["name"] for entry in missing[:6])
        rows.append(("not determined", f"{names}{' …' if len(missing) > 6 else ''}"))
    return rows


def _lost(error: np.ndarray) -> str:
    """Directions in which no point has a value, and how many points lack one in the others."""
    known = np.isfinite(error)
    lost = [axis for axis, any_known in zip("xyz", known.any(axis=0), strict=False) if not any_known]
    partly = int((~known[:, known.any(axis=0)]).any(axis=1).sum())
    return (f"; not determined along {', '.join(lost)}" if lost else "") + (
        f"; not determined at {partly} of {len(error)} points" if partly else ""
    )


def _points(points: Any, count: int) -> str:
    """How many, and why one place may be there more than once."""
    places = len({tuple(point) for point in points}) if points else count
    if places == count:
        return str(count)
    return (
        f"{count}, at {places} places: a place counts once for each direction of approach, temperature … at which "
        "effects move it otherwise"
    )


def _motions(content: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Largest value and uncertainty of what a map holds beside positions."""
    out = []
    for name, value in content.items():
        known = name in _PUBLISHED or name in ERROR_MOTIONS
        if not known or f"{name}_u" not in content or not isinstance(value, list):
            continue
        found, u = (np.array(content[key], dtype=float).reshape(-1) for key in (name, f"{name}_u"))
        good = np.isfinite(found)
        title = f"errors of {name.upper()}" if name in ("x", "y", "z") else name.replace("_", " ")
        if not good.any():
            out.append((title, "not determined"))
            continue
        unit = "rad" if name in ERROR_MOTIONS and parse_motion(name).is_rotation else "m"
        most, expanded = (quantity(float(size), unit) for size in (np.abs(found[good]).max(), 2 * u[good].max()))
        text = f"{most} at most, U (k = 2) at most {expanded}"
        out.append((title, text + ("" if good.all() else f"; {int((~good).sum())} of {len(good)} not determined")))
    return out


def _if_right(document: dict[str, Any]) -> str:
    """A warning where the readings speak against the model on which the uncertainty rests."""
    p = document.get("p_value")
    return ", if the model were right" if p is not None and p < _DOUBTFUL else ""


def _array(value: Any) -> np.ndarray:
    return np.array(value, dtype=float) if value else np.zeros((0, 3))


def _rms(vectors: np.ndarray) -> float:
    """Root mean square length of the vectors of which anything is known."""
    known = vectors[np.isfinite(vectors).any(axis=1)]
    return float(np.sqrt(np.mean(np.nansum(known**2, axis=1))))


def _largest(vectors: np.ndarray) -> float:
    """Greatest length of a vector."""
    return float(np.sqrt(np.max(np.nansum(vectors**2, axis=1))))


_MOST_ROWS = 40
_MOST_NAMES = 8


def show_result(screen: Console, document: Mapping[str, Any], opened: Sequence[Session], fit: JointFit) -> None:
    """Print a result document."""
    for session in opened:
        screen.print(session_headline(session))
    if document["effects"]:
        screen.print(f"model: {_variants(document)} with {', '.join(document['effects'])}")
    screen.print(goodness_of_fit(document))
    show_suspicions(screen, document["suspicious"])
    for words in (*reproducibility_words(document["spread"]), *not_ruled_out(document["spread"])):
        screen.print(words)
    show_table(screen, TextTable("", ("", ""), tuple(summary_rows({**document, "not_determined": []}))))
    for shown_of_direct in direct_tables(document["error_map"]):
        if isinstance(shown_of_direct, TextTable):
            show_table(screen, shown_of_direct)
        else:
            screen.print(shown_of_direct)
    if "agreement" in document:
        screen.print(document["agreement"]["statement"])
    for reason, rows in group_by_reason((str(entry["row"]), entry["reason"]) for entry in document["rejected"]):
        screen.print(f"not used: {'rows' if ',' in rows else 'row'} {rows} (the first row is 0): {reason}")
    aside = readings_set_aside(document, opened)
    if aside.rows:
        show_table(screen, aside)
    _show_parameters(screen, document, fit)
    for words in negative_words(fit, document["effects"]):
        screen.print(words)
    namesakes = _namesakes(fit)
    missing = document["not_determined"]
    lost = (("effect " * (entry["name"] in namesakes) + entry["name"], entry["why"]) for entry in missing)
    for why, names in group_by_reason(lost):
        screen.print(f"not determined: {names}: {why}")
    screen.print(f"datum: {datum_words(document)}")


def _namesakes(fit: JointFit) -> set[str]:
    """Effects that add nothing and have the name of an unknown that the model has by itself, such as C0Y."""
    added = {entry.name for model in fit.assembly.models for entry in model.left_out if entry.effect}
    return {name for name in added if name in ERROR_MOTIONS or name in SQUARENESS}


def datum_words(document: Mapping[str, Any]) -> str:
    """What the values refer to; of the map besides, where its datum is another one."""
    of_map = (document["error_map"] or {}).get("datum")
    own = str(document["datum"])
    return own if not of_map or of_map in own else f"{own}; map: {of_map}"


def readings_set_aside(document: Mapping[str, Any], opened: Sequence[Session]) -> TextTable:
    """What was set aside: when, where, and how far off, row by row; without rows where nothing was.

    Args:
        document: of the result.
        opened: the sessions that were identified, with all their readings.
    """
    labels = [entry["label"] for entry in document.get("sessions", [{"label": None}])]
    by_label = dict(zip(labels, opened, strict=True))
    rows = []
    for entry in document["rejected"]:
        session = by_label[entry.get("session")]
        readings = session.readings
        at = int(np.flatnonzero(readings.row == entry["row"])[0])
        if not np.isfinite(readings.displacement[at]):
            continue
        time = readings.columns.get("time")
        places = [f"{axis.upper()} {_place(axis, readings.columns[axis][at])}" for axis in "xyzabc"
                  if axis in readings.columns]  # fmt: skip
        named = [f"{name} {values[at]}" for name, values in readings.labels.items()]
        rows.append(
            (
                entry.get("session", ""),
                str(entry["row"]),
                "" if time is None else f"{time[at]:.1f}",
                session.setup_ids[readings.setup[at]],
                str(readings.repeat[at]),
                ", ".join([*named, *places]),
                micrometres(entry["deviation"]) if "deviation" in entry else "",
            )
        )
    heads = ("session", "row", "time, s", "setup", "repeat", "position, mm or °", "deviation, µm")
    note = "deviation from what all others predict; --keep ROW puts a reading back, --keep-all all of them"
    return TextTable("Readings set aside", heads, tuple(rows[:_MOST_ROWS]), note)


def _place(axis: str, value: float) -> str:
    return f"{np.degrees(value) if axis in 'abc' else 1e3 * value:.6g}"


def show_profiles(screen: Console, document: Mapping[str, Any]) -> None:
    """Profiles of the three axes by one of the formulations of a step diagonal."""
    for axis in "xyz":
        rows = tuple((str(k), *map(micrometres, row)) for k, row in enumerate(document["error_map"][axis]))
        title = f"{axis.upper()}: errors by the formulation {document['formulation']}, µm"
        if rows:
            show_table(screen, TextTable(title, ("block", "ex", "ey", "ez"), rows))


def _variants(document: Mapping[str, Any]) -> str:
    """The method's variant, of several sessions each with its label."""
    if "sessions" not in document:
        return str(document["model"])
    return ", ".join(f"{entry['model']} ({entry['label']})" for entry in document["sessions"])


def session_headline(session: Session) -> str:
    """What was measured, in one line."""
    ids = session.setup_ids
    names = ", ".join(ids[:_MOST_NAMES]) + (" …" if len(ids) > _MOST_NAMES else "")
    words = session.spec.words
    kind = session.method.replace("_", " ") if words is None else words(session.description)
    repeats = len(np.unique(session.readings.repeat))
    return (
        f"{kind}: {len(session.readings)} readings in {len(ids)} setup{'s' if len(ids) > 1 else ''} ({names}), "
        f"{repeats} repeat{'s' if repeats > 1 else ''}, declared standard uncertainty "
        f"{declared_words(session.description.standard_uncertainty)}"
    )


def goodness_of_fit(document: Mapping[str, Any]) -> str:
    """How well the model fits: the scatter of the readings against their declared uncertainty, in a sentence."""
    chi, p = document["reduced_chi_square"], document["p_value"]
    direct = scatter_words(document.get("error_map") or {}, p)
    if direct is not None:
        return direct
    ratio = chi**0.5
    if p < 1e-3:
        return (
            f"The readings scatter {rounded(ratio)} times their declared uncertainty about the model ({p_value(p)}): "
            "something is missing in it, or the declared uncertainty is too small. `mtcal diagnose` looks for it."
        )
    if p > 1 - 1e-3:
        return f"The readings scatter only {rounded(ratio)} times their declared uncertainty: it is stated too large."
    if p < 0.05:
        return (
            f"The model fits the readings nearly within their declared uncertainty ({p_value(p)}): something small may "
            "be missing in it. `mtcal diagnose` looks for it."
        )
    return f"The model fits the readings within their declared uncertainty ({p_value(p)})."


def group_by_reason(entries: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
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
    for entry in single[:_MOST_ROWS]:
        name = entry["name"]
        unknown = unknowns[name]
        place = unknown.kind in (Kind.PLACE, Kind.DEAD_PATH)
        what = unknown.meaning or unknown_in_words(unknown)
        texts = value_and_uncertainties(entry["value"], entry["standard_uncertainty"], entry["unit"], place)
        rows.append((name, *texts, "" if what == name else what))
    if rows:
        left = len(single) - len(rows)
        notes = [f"{left} more; --json gives all of them"] if left else []
        heads = ("name", "value", "u (k = 1)", "U (k = 2)", "unit", "what it is")
        show_table(screen, TextTable("Parameters", heads, tuple(rows), "; ".join(notes)))
    _show_tables(screen, document, unknowns, _namesakes(fit))


def motion_row(name: str, value: Array, u: Array, count: int, unit: str) -> tuple[str, ...]:
    """An error motion in a row: how many of its values are determined, the smallest, the largest, the largest U.

    Args:
        name: of the error motion.
        value: (n,) of what is determined, in `unit`.
        u: (n,) standard uncertainties.
        count: of all its values.
        unit: m or rad.
    """
    shown = "µrad" if unit == "rad" else "µm"
    many = str(count) if len(value) == count else f"{len(value)} of {count}"
    most = 2e6 * float(u.max())
    if len(value) < count and most < _DATUM:
        return (name, many, *[NOT_DETERMINED] * 3, shown)
    places = decimals(most) if _DATUM < most < 1e9 else 2
    return (name, many, *(fixed(1e6 * float(number), places) for number in (value.min(), value.max())),
            fixed(most, places), shown)  # fmt: skip


def _show_tables(
    screen: Console,
    document: Mapping[str, Any],
    unknowns: Mapping[str, Parameter],
    namesakes: Set[str],
) -> None:
    """Each table of an error motion in one row; none of what is not determined."""
    lost = {entry["name"] for entry in document["not_determined"]} - namesakes
    tables: dict[str, list[Mapping[str, Any]]] = {}
    for entry in document["parameters"]:
        unknown = unknowns[entry["name"]]
        if unknown.kind is Kind.MOTION and unknown.owner not in lost:
            tables.setdefault(unknown.family, []).append(entry)
    without = Counter(unknowns[name].family for name in lost if name in unknowns)
    rows = []
    for name, own in tables.items():
        value, u = (np.array([entry[key] for entry in own]) for key in ("value", "standard_uncertainty"))
        rows.append(motion_row(name, value, u, len(own) + without[name], own[0]["unit"]))
    if rows:
        heads = ("name", "values", "smallest", "largest", "U (k = 2) at most", "unit")
        empty = ["–: no value but the datum's"] if any(row[2] == NOT_DETERMINED for row in rows) else []
        note = "; ".join(["--json gives every value", *empty])
        show_table(screen, TextTable("Error motions", heads, tuple(rows), note))
