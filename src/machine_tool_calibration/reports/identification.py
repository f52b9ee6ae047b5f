# SPDX-License-Identifier: Apache-2.0
"""What `mtcal identify` tells people: the result document in words, micrometres and microradians."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from machine_tool_calibration.coverage import K
from machine_tool_calibration.diagnosis.history import Entry
from machine_tool_calibration.machine.error_motions import ERROR_MOTIONS, SQUARENESS, parse_motion
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import JointResult
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.model import Kind
from machine_tool_calibration.model.result import Result, fit_quality, map_rms, only_if_right, scatter_p_value
from machine_tool_calibration.reports import goodness
from machine_tool_calibration.reports.quantities import (
    MOST_NAMED,
    as_exact,
    declared_words,
    expanded_text,
    micrometres,
    not_ruled_out,
    quantity,
    reproducibility_words,
    rounded,
    value_and_uncertainties,
)
from machine_tool_calibration.reports.tables import Part, TextTable, heads, names_by_reason, suspicion_words
from machine_tool_calibration.reports.unknowns import unknown_in_words
from machine_tool_calibration.reports.values import STANDARDS, standard_tables, value_tables
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import Said, Verbatim, named, say, together

_MEMORY = 1.25  # by how much a standard uncertainty is widened by the noise's memory from which that is said


@dataclass(frozen=True)
class Measured:
    """Measurements as they were recorded, and what is to be fitted to them."""

    recorded: tuple[Session, ...]  # the measurements, with all their readings
    # those to fit, without what the history's model sets aside, and the model: one that was asked for, or one of the
    # history
    chosen: FitRequest
    history: tuple[Entry, ...] = ()  # the models from the first to the one in use, where it is the history's

    def document(self, result: Result | JointResult) -> dict[str, Any]:
        """The result as a JSON document, with the readings that the history's model set aside among the rejected."""
        document = result.document()
        last = self.history[-1].number if self.history else 0
        why = say("result.aside_by", n=last) if last else say("result.aside_by_history")
        for label, session, kept in zip(self.chosen.labels or ("",), self.recorded, self.chosen.sessions, strict=True):
            gone = sorted(set(session.readings.row.tolist()) - set(kept.readings.row.tolist()))
            named = {"session": label} if label else {}
            document["rejected"] += [{**named, "row": row, "reason": why} for row in gone]
            document["observations"] += len(gone)
        return document


_PUBLISHED = ("x", "y", "z", "workpiece_error", "workpiece_form")


def summary_rows(document: dict[str, Any]) -> list[tuple[str, str]]:
    """What the result of a session says, in words and micrometres."""
    rows: list[tuple[str, str]] = [
        (say("result.readings_used"), say("text.of", n=document["used"], count=document["observations"])),
        (say("result.rms_residual"), quantity(document["rms_residual"], "m")),
    ]
    if (chi := document.get("reduced_chi_square")) is not None:
        rows.append((say("result.chi"), say("result.chi_value", value=rounded(chi))))
    error_map = document.get("error_map") or {}
    every = (error_map.get(key) or np.zeros((0, 3)) for key in ("position_error", "position_error_u"))
    error, uncertainty = (np.array(value, dtype=float) for value in every)
    known = bool(np.isfinite(uncertainty).any())
    if error.size:
        count = len(error)
        places = len({tuple(point) for point in error_map.get("points") or ()}) or count
        told = str(count) if places == count else say("result.points_at", n=places, count=count)
        rows.append((say("result.points"), told))
        text = say("text.not_determined")
        expanded = (K * (map_rms(uncertainty) or 0.0), K * _largest(uncertainty)) if known else (None, None)
        if np.isfinite(error).any():
            sizes = zip((map_rms(error) or 0.0, _largest(error)), expanded, strict=True)
            text = _lost(_rms_and_most(as_exact(size, "m", u) for size, u in sizes), error)
        rows.append((say("result.position_error"), text))
        if known:
            text = _rms_and_most(expanded_text(u) for u in expanded if u is not None)
            if document.get("uncertainty") != "budget":
                text = say("result.without", text=text)
            doubtful = only_if_right(document.get("p_value"), error_map)
            rows.append((say("result.uncertainty"), say("result.if_right", text=text) if doubtful else text))
    motions = _motions(error_map)
    if document.get("uncertainty") != "budget" and not known:
        motions = [(title, say("result.without", text=text)) for title, text in motions]
    rows += motions
    if missing := document.get("not_determined") or []:
        names = ", ".join(entry["name"] for entry in missing[:6])
        rows.append((say("text.not_determined"), f"{names}{' …' if len(missing) > 6 else ''}"))
    return rows


def _rms_and_most(sizes: Iterable[str]) -> Said:
    rms, most = sizes
    return say("result.rms_and_most", rms=rms, most=most)


def _lost(text: Said, error: np.ndarray) -> Said:
    """The text with directions in which no point has a value, and at how many points each of the others has none."""
    known = np.isfinite(error)
    lost = [axis for axis, any_known in zip("xyz", known.any(axis=0), strict=False) if not any_known]
    if lost:
        text = say("result.lost_along", text=text, names=", ".join(lost))
    for axis, missing in zip("xyz", (~known).sum(axis=0).tolist(), strict=False):
        if missing and axis not in lost:
            text = say("result.lost_at", text=text, axis=axis, n=missing, count=len(error))
    return text


def _motions(content: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Largest value and uncertainty of what a map holds beside positions."""
    out: list[tuple[str, str]] = []
    for name, value in content.items():
        known = name in _PUBLISHED or name in ERROR_MOTIONS
        if not known or f"{name}_u" not in content or not isinstance(value, list):
            continue
        found, u = (np.array(content[key], dtype=float).reshape(-1) for key in (name, f"{name}_u"))
        good = np.isfinite(found)
        title: str = name
        if name in ("x", "y", "z"):
            title = say("result.errors_of", axis=name.upper())
        elif name not in ERROR_MOTIONS:
            title = say(f"result.{name}")
        if not good.any():
            out.append((title, say("text.not_determined")))
            continue
        unit = "rad" if name in ERROR_MOTIONS and parse_motion(name).is_rotation else "m"
        largest = K * float(u[good].max())
        most, expanded = (as_exact(size, unit, largest) for size in (float(np.abs(found[good]).max()), largest))
        text = say("result.at_most", most=most, u=expanded)
        if not good.all():
            text = say("result.lost_values", text=text, n=int((~good).sum()), count=len(good))
        out.append((title, text))
    return out


def _largest(vectors: np.ndarray) -> float:
    return float(np.sqrt(np.max(np.nansum(vectors**2, axis=1))))


_MOST_ROWS = 40
_MOST_PLACES = 24
_MOST_NAMES = 8


def result_parts(
    document: Mapping[str, Any], opened: Sequence[Session], result: Result | JointResult, *, on_page: bool = False
) -> Iterator[Part]:
    """A result: its document in words, with the sessions and the fit that it is of.

    On a page there is room for whole tables, and nobody types commands.
    """
    fit, most = result.joint, None if on_page else _MOST_PLACES
    yield from map(session_headline, opened)
    if document["effects"]:
        each = [f"{entry['model']} ({entry['label']})" for entry in document.get("sessions", ())]
        model = ", ".join(each) or document["model"]
        yield say("result.model_with", model=model, effects=", ".join(document["effects"]))
    fitting = goodness_of_fit(document)
    doubt = fit_quality(scatter_p_value(document["p_value"], document["error_map"])) in ("bad", "nearly")
    yield say("result.ask_diagnosis", text=fitting) if doubt and not on_page else fitting
    yield from goodness.free_words(document)
    yield from suspicion_words(document["suspicious"])
    yield from spread_words(document)
    yield TextTable("", ("", ""), tuple(summary_rows({**document, "not_determined": []})))
    for name in STANDARDS:
        yield from standard_tables(document["error_map"], name, most)
    yield from value_tables(result, most)
    if "agreement" in document:
        yield document["agreement"]["statement"]
    for reason, rows in group_by_reason((str(entry["row"]), entry["reason"]) for entry in document["rejected"]):
        yield say("result.not_used", n=2 if "," in rows else 1, names=rows, why=reason)
    tables = (readings_set_aside(document, opened), parameters_table(document, fit, None if on_page else _MOST_ROWS))
    yield from (table for table in tables if table.rows)
    yield from goodness.effect_words(fit, document["effects"])
    # Effects that add nothing and have the name of an unknown that the model has by itself, such as C0Y.
    added = {entry.name for model in fit.assembly.models for entry in model.left_out if entry.effect}
    namesakes = added & {*ERROR_MOTIONS, *SQUARENESS}
    missing = document["not_determined"]
    names = ((e["name"] if e["name"] not in namesakes else say("result.effect", name=e["name"])) for e in missing)
    reasons = group_by_reason(zip(names, (entry["why"] for entry in missing), strict=True))
    for why, lost in reasons[:_MOST_NAMES]:
        yield say("result.not_determined", names=lost, why=why)
    if (more := len(reasons) - _MOST_NAMES) > 0:
        yield say("result.not_determined_more", n=more)
    yield say("result.datum", datum=datum_words(document))
    yield from goodness.vague_words(document["error_map"] or {}, fit)
    yield from goodness.off_the_map_words(document["error_map"] or {})


def spread_words(document: Mapping[str, Any]) -> Iterator[str]:
    """What does not reproduce, and that noise has a memory.

    The most that the former may be only where the model fits, as runs share what it lacks.
    """
    yield from reproducibility_words(document["spread"])
    if document["memory_factor"] is None:
        yield say("fit.memory_unknown")
    elif document["memory_factor"] >= _MEMORY:
        yield say("fit.memory", times=rounded(document["memory_factor"]))
    if not only_if_right(document["p_value"], document["error_map"]):
        yield from not_ruled_out(document["spread"])


def datum_words(document: Mapping[str, Any]) -> str:
    """What the values refer to; of the map besides, where its datum is another one."""
    of_map = (document["error_map"] or {}).get("datum")
    own: str = document["datum"]
    return own if not of_map or of_map in own else say("datum.and_map", own=own, map=of_map)


def readings_set_aside(document: Mapping[str, Any], opened: Sequence[Session]) -> TextTable:
    """What was set aside: when, where, and how far off, row by row; without rows where nothing was."""
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
        at_axes = {axis: readings.columns[axis][at] for axis in "xyzabc" if axis in readings.columns}
        places = [f"{axis.upper()} {np.degrees(v) if axis in 'abc' else 1e3 * v:.6g}" for axis, v in at_axes.items()]
        labels = [together((named("column", name), Verbatim(values[at]))) for name, values in readings.labels.items()]
        rows.append(
            (
                entry.get("session", ""),
                str(entry["row"]),
                "" if time is None else f"{time[at]:.1f}",
                session.setup_ids[readings.setup[at]],
                str(readings.repeat[at]),
                together([*labels, *places], ", "),
                micrometres(entry["deviation"]) if "deviation" in entry else "",
            )
        )
    columns = heads("session", "row", "time_s", "setup", "repeat", "position", "deviation")
    return TextTable(say("result.set_aside"), columns, tuple(rows[:_MOST_ROWS]), say("result.note_aside"))


def session_headline(session: Session) -> str:
    """What was measured, in one line."""
    ids = [session.setup_ids[k] for k in np.unique(session.readings.setup)]  # of which something was read
    names = ", ".join(ids[:_MOST_NAMES]) + (" …" if len(ids) > _MOST_NAMES else "")
    return say(
        "result.headline",
        kind=spec_of(session).words(session.description) or named("method", session.method.replace("_", " ")),
        readings=say("result.readings", n=len(session.readings)),
        setups=say("result.setups", n=len(ids)),
        names=names,
        repeats=say("result.repeats", n=len(np.unique(session.readings.repeat))),
        declared=declared_words(session.description.standard_uncertainty),
    )


def goodness_of_fit(document: Mapping[str, Any]) -> Said:
    """How well the model fits: the scatter of the readings against their declared uncertainty, in a sentence."""
    return goodness.fit_words(document["reduced_chi_square"], document["p_value"], document.get("error_map") or {})


def group_by_reason(entries: Iterable[tuple[str, str]], most: int = _MOST_NAMES) -> list[tuple[str, str]]:
    """From (name, reason) to each reason with the names that share it, the first ones by name."""
    return [
        (reason, say("text.and_more", names=text, n=len(own) - most) if len(own) > most else text)
        for reason, own in names_by_reason(entries).items()
        for text in [together(own[:most], ", ")]
    ]


def parameters_table(document: Mapping[str, Any], fit: JointFit, most: int | None = None) -> TextTable:
    """The unknowns that are no values of a table or map: effects, squareness, places, zeros; all, or the first."""
    unknowns = fit.assembly.unknowns
    single = [entry for entry in document["parameters"] if unknowns[entry["name"]].kind is not Kind.MOTION]
    # Effects first, then what is of the machine (squareness), then what is of the setups.
    order = {Kind.EFFECT: 0, Kind.SQUARENESS: 1}
    single.sort(key=lambda entry: order.get(unknowns[entry["name"]].kind, 2))
    rows = []
    for entry in single[:most]:
        name = entry["name"]
        unknown = unknowns[name]
        place = unknown.kind in (Kind.PLACE, Kind.DEAD_PATH)
        what = unknown.meaning or unknown_in_words(unknown)
        texts = value_and_uncertainties(entry["value"], entry["standard_uncertainty"], entry["unit"], place)
        rows.append((name, *texts, "" if what == name else what))
    left = len(single) - len(rows)
    notes = [say("text.more_with_json", n=left)] if left else []
    if drawn := list(_drawn_to_usual_sizes(document, fit)):
        notes.append(say("result.drawn", sizes=together(drawn[:MOST_NAMED], ", ")))
    columns = heads("name", "value", "u1", "U2", "unit", "what_it_is")
    return TextTable(say("result.parameters"), columns, tuple(rows), together(notes, "; "))


def _drawn_to_usual_sizes(document: Mapping[str, Any], fit: JointFit) -> Iterator[str]:
    """Sizes of effects by least squares alone from which the published ones are farther off than these are certain."""
    alone = dict(zip((p.name for p in fit.assembly.parameters), fit.solution.theta.tolist(), strict=True))
    for entry in document["parameters"]:
        unknown, u = fit.assembly.unknowns[entry["name"]], entry["standard_uncertainty"]
        if unknown.kind is not Kind.EFFECT or unknown.reference != 0.0 or entry["value"] is None or u is None:
            continue
        size = alone[entry["name"]]
        if abs(size - entry["value"]) > u:
            yield f"{entry['name']} = {quantity(size, entry['unit'])}"
