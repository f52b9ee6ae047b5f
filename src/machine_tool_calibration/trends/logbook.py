# SPDX-License-Identifier: Apache-2.0
"""A machine's logbook: every session that was measured on it, with its result, in the order of entering.

It is one SQLite file, which can be copied and handed over whole. An entry is in it wholly or not at all, also where
two programs enter at once or one is killed, and triggers end every UPDATE and DELETE of what was entered; what was
wrong is withdrawn by a line beside it. Any program for SQLite reads it; the result and the sizes are JSON,
description and readings the text of `session.yaml` and `observations.csv`, whose SHA-256, one after the other, is the
entry's.
"""

import datetime
import io
import json
import sqlite3
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any

from machine_tool_calibration.errors import CalibrationError, SessionError, did_you_mean, one_line
from machine_tool_calibration.session import DESCRIPTION_FILE, OBSERVATIONS_FILE
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.provenance import name_of_machine, recorded_texts
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.text import begins_with
from machine_tool_calibration.trends.statement import Size

# "mtlb": says of which program a database is (SQLite's application_id), and which version its tables have.
_APPLICATION, _VERSION = 0x6D746C62, 1

_DAY = datetime.timedelta(days=1)
_PATIENCE = 30.0  # seconds that one program waits for another that is entering
_COLUMNS = (
    "machine", "date", "instrument", "label", "sha256", "software", "result", "sizes", "description", "readings",
)  # fmt: skip


def _table(name: str, row: str, columns: str) -> str:
    """A table of its own, of which nothing is changed; other versions of the program read the entries all the same."""
    return f"""
CREATE TABLE IF NOT EXISTS {name} ({columns}, entered TEXT NOT NULL DEFAULT CURRENT_TIMESTAMP);
CREATE TRIGGER IF NOT EXISTS {row}_kept BEFORE UPDATE ON {name}
    BEGIN SELECT RAISE(ABORT, '{name} are never changed'); END;
CREATE TRIGGER IF NOT EXISTS {row}_stays BEFORE DELETE ON {name}
    BEGIN SELECT RAISE(ABORT, '{name} are never removed'); END;
"""


_ENTRIES = _table(
    "entries", "entry", f"number INTEGER PRIMARY KEY, {', '.join(f'{name} TEXT NOT NULL' for name in _COLUMNS)}"
)
_TABLES = f"{_ENTRIES}PRAGMA application_id = {_APPLICATION};\nPRAGMA user_version = {_VERSION};\n"
# Which a logbook has from the first line in them on.
_WITHDRAWALS = _table("withdrawals", "withdrawal", "number INTEGER PRIMARY KEY, why TEXT NOT NULL")
_DIAGNOSES = _table("diagnoses", "diagnosis", "sha256 TEXT PRIMARY KEY, document TEXT NOT NULL")
# Keys of `instrument` in `about` that say which one it is; others, such as a certificate, may change with time.
_IDENTITY = ("name", "type", "model", "serial", "serial_number", "id")


@dataclass(frozen=True)
class Entry:
    """One session in a logbook."""

    number: int  # in the logbook, from 1; 0 before it is entered
    machine: str  # its name
    date: str  # when it was measured, ISO 8601, a day or a moment
    instrument: str  # which one read: kind, and name or serial number where `about` has them
    label: str  # name of the session's folder
    sha256: str  # of its data, as in the result's provenance
    software: str  # name and version that evaluated it
    result: Mapping[str, Any]  # the result document (`mtcal-result/1`)
    sizes: tuple[Size, ...]  # of error motions, squareness, reversal and effects
    description: str  # text of `session.yaml`
    readings: str  # text of `observations.csv`

    @property
    def moment(self) -> datetime.datetime:
        """When it was measured: UTC where no time zone is said."""
        return _moment(self.date)

    @cached_property
    def session(self) -> Session:
        """The measurement, read again; a SessionError if it cannot be, or its SHA-256 is not that which was entered."""
        if sha256((self.description + self.readings).encode()).hexdigest() != self.sha256:
            raise SessionError(f"entry {self.number} ({self.label}): the data has another SHA-256 than was entered")
        with tempfile.TemporaryDirectory() as folder:
            for name, text in ((DESCRIPTION_FILE, self.description), (OBSERVATIONS_FILE, self.readings)):
                (Path(folder) / name).write_text(text, encoding="utf-8", newline="")
            return replace(read_session(Path(folder), check=False), source=self.label)

    @cached_property
    def temperatures(self) -> Mapping[str, float]:
        """Mean of every recorded temperature, degrees Celsius, by its column."""
        if "temperature_" not in self.readings.partition("\n")[0]:
            return {}
        import pandas as pd  # slow to load, and a list of entries needs it not

        table = pd.read_csv(io.StringIO(self.readings), usecols=lambda name: name.startswith("temperature_"))
        return {str(name): float(mean) for name, mean in table.mean(numeric_only=True).items()}

    def document(self) -> dict[str, Any]:
        """What a list of entries says of it."""
        names = ("number", "machine", "date", "instrument", "label", "sha256", "software", "sizes")
        told = {name: getattr(self, name) for name in names}
        return told | {key: self.result.get(key) for key in ("method", "model", "effects")}


@dataclass(frozen=True)
class Withdrawn:
    """An entry that counts no more."""

    number: int
    label: str  # name of the session's folder
    sha256: str  # of its data
    why: str


def entry_of(
    session: Session,
    label: str,
    result: Mapping[str, Any],
    sizes: Sequence[Size],
    *,
    machine: str | None = None,
    date: str | None = None,
    instrument: str | None = None,
) -> Entry:
    """What is to be entered of a session: all that was recorded, its result document, and sizes of what was found.

    Machine, date (ISO 8601) and instrument need be given only where `about` does not say them. A CalibrationError if
    nothing says which machine it was, or when, or it would be measured tomorrow.
    """
    about, origin = session.description.about, result["provenance"]
    if not (name := (machine or name_of_machine(about)).strip()):
        raise CalibrationError(f"{label}: nothing says which machine it is: `about: {{machine: …}}`, or --machine")
    if not (told := date or about.get("date") or about.get("time")):
        raise CalibrationError(f"{label}: nothing says when it was measured: `about: {{date: 2026-05-04}}`, or --date")
    when = date_of(str(told), label)
    if _moment(when) > datetime.datetime.now(datetime.UTC) + _DAY:
        raise CalibrationError(f"{label}: its date {when} is in the future by this computer's clock")
    description, readings = recorded_texts(session)
    return Entry(
        number=0,
        machine=name,
        date=when,
        instrument=instrument or _instrument(session),
        label=label,
        sha256=origin["sha256"],
        software=origin["software"],
        result=result,
        sizes=tuple(sizes),
        description=description,
        readings=readings,
    )


def date_of(text: str, where: str) -> str:
    """A day or moment in ISO 8601, as it is entered; a CalibrationError if it is none."""
    for kind in (datetime.date, datetime.datetime):
        with suppress(ValueError):
            return kind.fromisoformat(text).isoformat()
    raise CalibrationError(f"{where}: {text!r} is no date such as 2026-05-04 (ISO 8601)")


def last_moment(date: str) -> datetime.datetime:
    """Until when a measurement of a day or moment of `date_of` was made: a day counts to its end."""
    day = _DAY - datetime.timedelta(microseconds=1) if len(date) == len("2026-05-04") else datetime.timedelta()
    return _moment(date) + day


def _moment(date: str) -> datetime.datetime:
    moment = datetime.datetime.fromisoformat(date)
    return moment if moment.tzinfo else moment.replace(tzinfo=datetime.UTC)


def _instrument(session: Session) -> str:
    about = session.description.about.get("instrument", "")
    if isinstance(about, Mapping):
        about = " ".join(str(about[key]) for key in _IDENTITY if about.get(key))
    kind = session.instrument or session.method
    return f"{kind}: {about}" if about and isinstance(about, str) else kind


def is_logbook(path: Path) -> bool:
    """Whether a file is an SQLite database, which of all that this package reads only a logbook is."""
    return begins_with(path, b"SQLite format 3\x00")


class Logbook:
    """The entries of a file."""

    def __init__(self, path: Path) -> None:
        """Of a file, which the first entry makes."""
        self.path = path

    def add(self, entry: Entry) -> tuple[Entry, bool]:
        """Enter a session: the entry as it is in the logbook, and whether it is new.

        A CalibrationError if it fails; a SessionError: the machine has the same readings with another description.
        """
        with self._open(make=True) as database, database:
            database.execute("BEGIN IMMEDIATE")  # so that nobody enters between looking and entering
            (whole,) = database.execute("PRAGMA quick_check(1)").fetchone()
            if whole != "ok":
                raise CalibrationError(f"{self.path}: is damaged, and nothing is entered: {one_line(whole)}")
            if found := self._valid(database, "WHERE sha256 = ?", entry.sha256):
                return found[0], False
            if found := self._valid(database, "WHERE machine = ? AND readings = ?", entry.machine, entry.readings):
                there = f"those of entry {found[0].number} of {found[0].date}"
                raise SessionError(f"{entry.label}: its readings are {there}, with another description")
            values = {name: getattr(entry, name) for name in _COLUMNS}
            values["result"] = json.dumps(entry.result, ensure_ascii=False, allow_nan=False)
            values["sizes"] = json.dumps([asdict(size) for size in entry.sizes], ensure_ascii=False)
            names, places = ", ".join(_COLUMNS), ", ".join("?" * len(_COLUMNS))
            done = database.execute(f"INSERT INTO entries ({names}) VALUES ({places})", [*values.values()])
        return replace(entry, number=int(done.lastrowid or 0)), True

    def withdraw(self, number: int, why: str) -> Withdrawn:
        """Say why an entry counts no more, be it damaged; it stays. A CalibrationError: none of that number counts."""
        with self._open(make=True) as database, database:
            database.executescript(f"BEGIN IMMEDIATE;{_WITHDRAWALS}COMMIT;")
            database.execute("BEGIN IMMEDIATE")
            found = self._rows(database, "WHERE number = ?", number)
            if not found or number in self._withdrawn(database):
                raise CalibrationError(f"{self.path}: no entry {number}, or it is withdrawn already")
            database.execute("INSERT INTO withdrawals (number, why) VALUES (?, ?)", (number, why))
        return Withdrawn(number, found[0]["label"], found[0]["sha256"], why)

    def withdrawn(self) -> tuple[Withdrawn, ...]:
        """Entries that count no more; raises as `entries`."""
        with self._open() as database:
            why, every = self._withdrawn(database), self._rows(database, "ORDER BY number")
        gone = [row for row in every if row["number"] in why]
        return tuple(Withdrawn(one["number"], one["label"], one["sha256"], why[one["number"]]) for one in gone)

    def add_diagnosis(self, sha256: str, document: Mapping[str, Any]) -> None:
        """Keep a diagnosis, in JSON's types, by its session's SHA-256; the first one stays. Raises as `add`."""
        text = json.dumps(document, ensure_ascii=False, allow_nan=False)
        with self._open(make=True) as database, database:
            database.executescript(f"BEGIN IMMEDIATE;{_DIAGNOSES}COMMIT;")
            database.execute("INSERT OR IGNORE INTO diagnoses (sha256, document) VALUES (?, ?)", (sha256, text))

    def diagnoses(self) -> dict[str, dict[str, Any]]:
        """What diagnoses say, by the SHA-256 of their session's data; nothing where there is no logbook yet."""
        if not self.path.exists():
            return {}
        with self._open() as database:
            if not self._has(database, "diagnoses"):
                return {}
            rows = database.execute("SELECT sha256, document FROM diagnoses").fetchall()
        return {sha256: json.loads(document) for sha256, document in rows}

    def entries(self, machine: str | None = None) -> tuple[Entry, ...]:
        """By date those that count, of a machine or of all; a CalibrationError: no such file, machine, or logbook."""
        if not self.path.exists():
            raise CalibrationError(f"{self.path}: no such logbook; `mtcal logbook add {self.path} SESSION` begins one")
        with self._open() as database:
            found = sorted(self._valid(database, "ORDER BY number"), key=lambda entry: entry.moment)
        if machine is None:
            return tuple(found)
        known = list(dict.fromkeys(entry.machine for entry in found))
        if machine not in known:
            near, listed = did_you_mean(machine, known), ", ".join(known) or "none"
            raise CalibrationError(f"{self.path}: no machine {machine!r}{near}; there is {listed}")
        return tuple(entry for entry in found if entry.machine == machine)

    def of_one(self, machine: str | None = None) -> tuple[Entry, ...]:
        """Entries of the machine named, or the only one; raises as `entries`, or if there are none, or several."""
        found = self.entries(machine)
        names = list(dict.fromkeys(entry.machine for entry in found))
        if not found:
            raise CalibrationError(f"{self.path}: has no entries")
        if len(names) > 1:
            raise CalibrationError(f"{self.path}: say of which machine: {', '.join(names)}")
        return found

    @contextmanager
    def _open(self, *, make: bool = False) -> Iterator[sqlite3.Connection]:
        try:
            uri = f"{self.path.absolute().as_uri()}?mode={'rwc' if make else 'ro'}"
            # Without transactions of the library's own, which begin too late.
            with closing(sqlite3.connect(uri, _PATIENCE, isolation_level=None, uri=True)) as database:
                (kind,) = database.execute("PRAGMA application_id").fetchone()
                (tables,) = database.execute("SELECT count(*) FROM sqlite_master").fetchone()
                (version,) = database.execute("PRAGMA user_version").fetchone()
                if make and not tables and kind == 0:
                    database.executescript(f"BEGIN IMMEDIATE;{_TABLES}COMMIT;")
                elif kind != _APPLICATION:
                    raise CalibrationError(f"{self.path}: is a database, but no logbook of mtcal")
                elif version != _VERSION:
                    raise CalibrationError(f"{self.path}: a logbook of version {version}, not {_VERSION}")
                yield database
        except sqlite3.DatabaseError as error:
            raise CalibrationError(f"{self.path}: cannot be used as a logbook: {error}") from None

    @staticmethod
    def _has(database: sqlite3.Connection, table: str) -> bool:
        return bool(database.execute("SELECT 1 FROM sqlite_master WHERE name = ?", (table,)).fetchone())

    def _withdrawn(self, database: sqlite3.Connection) -> dict[int, str]:
        if not self._has(database, "withdrawals"):
            return {}
        return dict(database.execute("SELECT number, why FROM withdrawals").fetchall())

    def _valid(self, database: sqlite3.Connection, rest: str, *values: str | int) -> list[Entry]:
        gone = self._withdrawn(database)
        return [self._entry(row) for row in self._rows(database, rest, *values) if row["number"] not in gone]

    def _entry(self, row: Mapping[str, Any]) -> Entry:
        try:
            sizes = tuple(Size(**s) for s in json.loads(row["sizes"]))
            found = Entry(**{**row, "result": json.loads(row["result"]), "sizes": sizes})
            _ = found.moment, found.result["method"]
        except (ValueError, TypeError, KeyError):
            which = f"entry {row['number']} ({row['label']})"
            raise CalibrationError(f"{self.path}: {which} is damaged: `mtcal logbook withdraw` leaves it out") from None
        return found

    @staticmethod
    def _rows(database: sqlite3.Connection, rest: str, *values: str | int) -> list[dict[str, Any]]:
        found = database.execute(f"SELECT number, {', '.join(_COLUMNS)} FROM entries {rest}", values).fetchall()
        return [dict(zip(("number", *_COLUMNS), row, strict=True)) for row in found]
