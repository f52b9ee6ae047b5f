# SPDX-License-Identifier: Apache-2.0
"""Where a result comes from: what the measurement says of itself, a hash of its data, software, model and effects."""

import hashlib
import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

from machine_tool_calibration.session.folder import readings_frame
from machine_tool_calibration.session.parse import description_yaml
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.version import __version__
from machine_tool_calibration.words import say, together

SOFTWARE = "machine_tool_calibration"
_SHORT = 12  # figures of a hash that pictures and lines of text show


@dataclass(frozen=True)
class Origin:
    """One measurement that a result was made from."""

    label: str  # its name among several; empty for a single one
    about: Mapping[str, Any]  # descriptive data as `session.yaml` gives them
    measured: str | None  # when, as `date` in `about` says; None where it does not
    sha256: str  # of its data (`data_hash`)


@dataclass(frozen=True)
class Provenance:
    """What a result was made from, by what, and when."""

    evaluated: str  # when, ISO 8601
    software: str  # name and version
    model: str  # variant of the method's model
    effects: tuple[str, ...]  # ids of the physical effects in it
    sha256: str  # of all data; that of the measurement where there is one, whatever the order where there are several
    sessions: tuple[Origin, ...]  # the measurements

    def document(self) -> dict[str, Any]:
        """As part of a document."""
        return {**asdict(self), "effects": list(self.effects), "sessions": [asdict(one) for one in self.sessions]}

    def lines(self) -> list[tuple[str, str]]:
        """Names and values for a head of a file, one a line."""
        out: list[tuple[str, str]] = []
        for origin in self.sessions:
            where = f"{origin.label}: " if origin.label else ""
            out += [(f"{where}{name}", value) for name, value in flattened(origin.about)]
            out += [(f"{where}sha256 of the data", origin.sha256)] if len(self.sessions) > 1 else []
        return [
            *out,
            ("evaluated", self.evaluated),
            ("software", self.software),
            ("model", ", ".join([self.model, *self.effects])),
            ("sha256 of the data", self.sha256),
        ]

    @property
    def footer(self) -> str:
        """In one line, for the foot of a picture."""
        machines = dict.fromkeys(name_of_machine(origin.about) for origin in self.sessions)
        dates = dict.fromkeys(origin.measured for origin in self.sessions if origin.measured)
        parts = [
            *(name for name in machines if name),
            *(say("footer.measured", date=date) for date in dates),
            say("footer.evaluated", date=self.evaluated[:10]),
            self.software,
            ", ".join([self.model, *self.effects]),
            say("footer.data", sum=self.sha256[:_SHORT]),
        ]
        return together((part for part in parts if part), "  ·  ")


def name_of_machine(about: Mapping[str, Any]) -> str:
    """What `about` says under `machine`: a text, or the `name` in a mapping."""
    found = about.get("machine", "")
    return str(found.get("name", "") if isinstance(found, Mapping) else found if isinstance(found, str) else "")


def flattened(about: Any, before: str = "") -> list[tuple[str, str]]:
    """Nested descriptive data as names and values: `instrument.serial`, `certificates[1].date`."""
    if isinstance(about, Mapping):
        entries = [(f"{before}.{key}" if before else str(key), value) for key, value in about.items()]
    elif isinstance(about, list | tuple):
        entries = [(f"{before}[{k}]", value) for k, value in enumerate(about, start=1)]
    else:
        return [(before, str(about))]
    return [pair for name, value in entries for pair in flattened(value, name)]


def data_hash(session: Session) -> str:
    """SHA-256 of a measurement's description and of all its recorded readings, as 64 hexadecimal figures.

    It is that of `session.yaml` followed by `observations.csv` as this package writes them (`mtcal convert`), so a
    folder and a recording of the same measurement agree, and any program for sums can check it.
    """
    return hashlib.sha256("".join(recorded_texts(session)).encode()).hexdigest()


def recorded_texts(session: Session) -> tuple[str, str]:
    """`session.yaml` and `observations.csv` of a measurement as it was recorded, of which `data_hash` is the sum."""
    from machine_tool_calibration.session.csv_text import write_csv  # here, as it brings pandas

    text = io.StringIO(newline="")
    write_csv(readings_frame(session.as_recorded), text)
    return description_yaml(session.description), text.getvalue()


def provenance(
    sessions: Sequence[Session], labels: Sequence[str] | None = None, *, model: str = "", effects: Sequence[str] = ()
) -> Provenance:
    """The record of a result; `labels` name sessions, `model` each variant. The hash is of all that was recorded."""
    named = labels if labels is not None and len(sessions) > 1 else [""] * len(sessions)
    origins = tuple(
        Origin(label, session.description.about, _text(session.description.about.get("date")), data_hash(session))
        for label, session in zip(named, sessions, strict=True)
    )
    whole = origins[0].sha256
    if len(origins) > 1:
        whole = hashlib.sha256("\n".join(sorted(origin.sha256 for origin in origins)).encode()).hexdigest()
    return Provenance(_now(), f"{SOFTWARE} {__version__}", model, tuple(effects), whole, origins)


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) and value else None


def _now() -> str:
    """The present time; that of SOURCE_DATE_EPOCH where the same document is to be made again to the last byte."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    moment = datetime.fromtimestamp(int(epoch), UTC) if epoch.isdecimal() else datetime.now(UTC)
    return moment.isoformat(timespec="seconds")
