# SPDX-License-Identifier: Apache-2.0
"""What a measurement holds: setups, readings and columns of a session, topics of a recording."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.json_types import plain
from machine_tool_calibration.reports.documents import picked
from machine_tool_calibration.reports.quantities import declared_words, duration, fixed
from machine_tool_calibration.reports.tables import Part, TextTable, heads, suspicion_words, table
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import Verbatim, named, say

if TYPE_CHECKING:
    from machine_tool_calibration.recording.reader import BagReader
    from machine_tool_calibration.session.session import Session
    from machine_tool_calibration.session.summary import ColumnSummary, SessionSummary

_LARGEST_DEVIATION = 1e-3  # displacements that are all smaller, m, are deviations: shown in micrometres
_UNITS = {
    **dict.fromkeys(("x", "y", "z", "displacement"), ("mm", 1e3)),
    **dict.fromkeys(("a", "b", "c", "azimuth", "elevation"), ("°", math.degrees(1.0))),
    **{"time": ("s", 1.0), "air_pressure": ("hPa", 0.01), "relative_humidity": ("%", 100.0)},
}


def measurement_document(
    path: Path, bag: BagReader | None, session: Session | None, summary: SessionSummary | None, absent: str
) -> Mapping[str, Any]:
    """The content of `mtcal-info/1`: the session in figures and as described, the recording with its topics."""
    document: dict[str, Any] = {"format": "mtcal-info/1", "path": path, "kind": "bag" if bag else "session"}
    if session is not None and summary is not None:
        document["measurement"] = {
            **plain(summary),
            "models": dict(spec_of(session).models),
            "description": session.description.model_dump(mode="json", exclude_none=True),
        }
    else:
        document["measurement"] = None
        document["why_no_measurement"] = absent
    if bag is not None:
        document["bag"] = {
            "files": bag.files,
            "size": sum(file.stat().st_size for file in bag.files),
            "messages": bag.messages_in_all,
            "start": bag.first,
            "duration": bag.duration,
            "topics": [
                picked(topic, "name", "type", "messages", "type_hash")
                | {"latched": any(profile.latched for profile in topic.qos)}
                for topic in sorted(bag.topics.values(), key=lambda topic: topic.name)
            ],
        }
    return document


def recording_parts(bag: BagReader, absent: str) -> Iterator[Part]:
    """Files, duration and topics of a recording, and why it holds no measurement if it holds none."""
    size = sum(file.stat().st_size for file in bag.files)
    try:
        start = datetime.fromtimestamp(bag.first / 1e9, UTC).isoformat(sep=" ", timespec="seconds")
    except (ValueError, OverflowError, OSError):
        start = f"{bag.first} ns"
    yield f"{bag.path}{say('recorded.recording', n=len(bag.files), size=f'{size / 1e6:.2f}')}"
    yield say("recorded.messages", n=bag.messages_in_all, time=f"{bag.duration:.1f}", start=start)
    yield table(
        say("recorded.topics"),
        sorted(bag.topics.values(), key=lambda topic: topic.name),
        topic=lambda topic: topic.name,
        type=lambda topic: topic.type,
        messages=lambda topic: str(topic.messages),
        per_second=lambda topic: f"{topic.messages / bag.duration:.1f}" if bag.duration > 0 else "",
        latched=lambda topic: say("text.yes") if any(profile.latched for profile in topic.qos) else "",
    )
    if absent:
        yield say("recorded.nothing", why=absent.split(": ", 1)[-1])


def session_parts(session: Session, summary: SessionSummary) -> Iterator[Part]:
    """Setups and columns of a session."""
    method = named("method", summary.method.replace("_", " "))
    yield f"{session.source}{say('recorded.session', method=method, chain=session.description.machine.chain)}"
    yield counts_in_words(session, summary)
    yield from session_tables(session, summary)
    yield from suspicion_words(summary.suspicious)
    if summary.labels:
        yield say("recorded.labels", names=", ".join(summary.labels))


def counts_in_words(session: Session, summary: SessionSummary) -> str:
    """How many readings there are, in what time, and their declared uncertainty."""
    key = "recorded.counts" if summary.duration is None else "recorded.counts_in"
    counts = picked(summary, "missing", "targets") | {"n": summary.readings, "time": duration(summary.duration)}
    return say(key, **counts, declared=declared_words(session.description.standard_uncertainty))


def session_tables(session: Session, summary: SessionSummary) -> Iterator[TextTable]:
    """Setups and columns of a session, and the models that its method has, where there are several."""
    yield table(
        say("recorded.setups"),
        zip(summary.setups, session.description.setups, strict=True),
        setup=lambda one: Verbatim(one[0].id),
        where=lambda one: _place(one[1]),
        readings=lambda one: str(one[0].readings),
        missing=lambda one: str(one[0].missing or ""),
        repeats=lambda one: str(one[0].repeats),
        from_min=lambda one: _minutes(one[0].first_time),
        to_min=lambda one: _minutes(one[0].last_time),
    )
    columns = heads("column", "from", "to", "unit", "missing")
    yield TextTable(say("recorded.columns"), columns, tuple(map(_column, summary.columns)), say("recorded.note"))
    if len(spec_of(session).models) > 1:
        yield TextTable(say("recorded.models"), heads("name", "when"), tuple(spec_of(session).models.items()))


def _place(setup: Any) -> str:
    """Where a setup stands, or which one it is; empty where it has no place of its own."""
    if hasattr(setup, "position"):
        return "(" + ", ".join(fixed(1e3 * value, 1) for value in setup.position) + ") mm"
    if hasattr(setup, "direction"):
        signs = "".join("+" if value > 0 else "-" if value < 0 else "0" for value in setup.direction)
        return say(f"place.{setup.kind}", signs=signs)
    if hasattr(setup, "c"):
        return f"c = {math.degrees(setup.c):.2f}°"
    return ""


def _column(column: ColumnSummary) -> tuple[str, str, str, str, str]:
    other = ("°C" if column.name.startswith("temperature_") else "", 1.0)
    unit, factor = _UNITS.get(column.name, other)
    if column.name == "displacement" and max(abs(column.low or 0.0), abs(column.high or 0.0)) < _LARGEST_DEVIATION:
        unit, factor = "µm", 1e6
    low, high = (("" if value is None else f"{value * factor:.6g}") for value in (column.low, column.high))
    return named("column", column.name), low, high, unit, str(column.missing or "")


def _minutes(seconds: float | None) -> str:
    return "" if seconds is None else f"{seconds / 60.0:.1f}"
