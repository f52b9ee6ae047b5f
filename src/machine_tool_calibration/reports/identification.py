# SPDX-License-Identifier: Apache-2.0
"""What `mtcal identify` tells people: the result document in words, micrometres and microradians."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.machine.error_motions import ERROR_MOTIONS, SQUARENESS, parse_motion
from machine_tool_calibration.model.model import Kind
from machine_tool_calibration.reports.direct_deviations import direct_tables, scatter_words
from machine_tool_calibration.reports.goodness import fit_words, fits
from machine_tool_calibration.reports.quantities import (
    as_exact,
    declared_words,
    micrometres,
    not_ruled_out,
    quantity,
    reproducibility_words,
    rounded,
    value_and_uncertainties,
)
from machine_tool_calibration.reports.signs import negative_words
from machine_tool_calibration.reports.standards import STANDARDS, standard_tables
from machine_tool_calibration.reports.tables import TextTable, show_suspicions, show_table
from machine_tool_calibration.reports.unknowns import unknown_in_words
from machine_tool_calibration.reports.values import value_tables
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import Said

if TYPE_CHECKING:
    from rich.console import Console

    from machine_tool_calibration.methods.identify import JointResult
    from machine_tool_calibration.model.fit import JointFit
    from machine_tool_calibration.model.result import Result
    from machine_tool_calibration.session.session import Session

__all__ = [
    "datum_words",
    "goodness_of_fit",
    "group_by_reason",
    "readings_set_aside",
    "session_headline",
    "show_profiles",
    "show_result",
    "summary_rows",
]


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
        known = np.isfinite(uncertainty).any()
        expanded = (2 * _rms(uncertainty), 2 * _largest(uncertainty)) if known else (None, None)
        if np.isfinite(error).any():
            shown = [as_exact(size, "m", u) for size, u in zip((_rms(error), _largest(error)), expanded, strict=True)]
            text = f"{shown[0]} RMS, {shown[1]} at most{_lost(error)}"
        rows.append(("position error", text))
        if known:
            mean, most = (as_exact(u, "m", u) for u in expanded if u is not None)
            text = f"{mean} RMS, {most} at most{_without(document)}{_if_right(document)}"
            rows.append(("its uncertainty U (k = 2)", text))
    rows += _motions(error_map)
    missing = document.get("not_determined") or []
    if missing:
        names = ", ".join(entry["name"] for entry in missing[:6])
        rows.append(("not determined", f"{names}{' …' if len(missing) > 6 else ''}"))
    return rows


def _without(document: Mapping[str, Any]) -> str:
    """What U lacks."""
    return "" if document.get("uncertainty") == "budget" else ", without instrument and temperature"


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
        f"{count} at {places} places: one for each direction of approach (or temperature) in which a place was reached"
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
        largest = 2 * float(u[good].max())
        most, expanded = (as_exact(size, unit, largest) for size in (float(np.abs(found[good]).max()), largest))
        text = f"{most} at most, U (k = 2) at most {expanded}"
        out.append((title, text + ("" if good.all() else f"; {int((~good).sum())} of {len(good)} not determined")))
    return out


def _if_right(document: dict[str, Any]) -> str:
    """A warning where the readings speak against the model on which the uncertainty rests."""
    if "one_direction" in ((document.get("error_map") or {}).get("scatter") or {}):
        return ""  # only the reversal, which is part of the result, is in it beside the scatter
    return ", if the model were right" if fits(document.get("p_value")) == "bad" else ""


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
_MOST_PLACES = 24
_MOST_NAMES = 8


def show_result(
    screen: Console, document: Mapping[str, Any], opened: Sequence[Session], result: Result | JointResult
) -> None:
    """Print a result: its document, with the sessions and the fit that it is of."""
    fit = result.joint
    for session in opened:
        screen.print(session_headline(session))
    if document["effects"]:
        screen.print(f"model: {_variants(document)} with {', '.join(document['effects'])}")
    ask = " `mtcal diagnose` looks for what is missing." if fits(document["p_value"]) in ("bad", "nearly") else ""
    screen.print(goodness_of_fit(document) + ask)
    show_suspicions(screen, document["suspicious"])
    for words in (*reproducibility_words(document["spread"]), *not_ruled_out(document["spread"])):
        screen.print(words)
    show_table(screen, TextTable("", ("", ""), tuple(summary_rows({**document, "not_determined": []}))))
    of_standards = (standard_tables(document["error_map"], name, _MOST_PLACES) for name in STANDARDS)
    for part in chain(direct_tables(document["error_map"]), *of_standards, value_tables(result, _MOST_PLACES)):
        if isinstance(part, TextTable):
            show_table(screen, part)
        else:
            screen.print(part)
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
    words = spec_of(session).words
    kind = session.method.replace("_", " ") if words is None else words(session.description)
    repeats = len(np.unique(session.readings.repeat))
    return (
        f"{kind}: {len(session.readings)} readings in {len(ids)} setup{'s' if len(ids) > 1 else ''} ({names}), "
        f"{repeats} repeat{'s' if repeats > 1 else ''}, declared standard uncertainty "
        f"{declared_words(session.description.standard_uncertainty)}"
    )


def goodness_of_fit(document: Mapping[str, Any]) -> Said:
    """How well the model fits: the scatter of the readings against their declared uncertainty, in a sentence."""
    direct = scatter_words(document.get("error_map") or {}, document["p_value"])
    return direct or fit_words(document["reduced_chi_square"], document["p_value"])


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
