# SPDX-License-Identifier: Apache-2.0
"""The models of a measurement that were tried: `history.yaml`, the file that keeps them, and tables of them."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from machine_tool_calibration.diagnosis.history import Entry, History
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.files import whole, writing
from machine_tool_calibration.recording.open import is_session_folder
from machine_tool_calibration.reports.documents import picked
from machine_tool_calibration.reports.quantities import micrometres, of_map, quantity, rounded
from machine_tool_calibration.reports.tables import TextTable, table
from machine_tool_calibration.session.record import validated
from machine_tool_calibration.session.text import LARGEST_TABLE, PlainDumper, read_yaml
from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from machine_tool_calibration.session.session import Session

HISTORY_FILE = "history.yaml"
# Of a file's name that names several sessions, bytes: file systems allow 255.
_LONGEST_NAME, _SHORT_NAME = 200, 40
_HEAD = "# Models tried by `mtcal improve`; `mtcal history` lists, compares and undoes them.\n"


def history_path(*measurements: Path) -> Path:
    """Where a history is kept: in the session folder, beside the recording, or beside the first of several sessions.

    Of several the first by its path, in whatever order they are given; the file's name names them all.
    """
    files = ("session.yaml", "observations.csv")
    folders = [one.parent if one.is_file() and one.name in files else one for one in map(Path, measurements)]
    if len(folders) > 1:
        ordered = sorted(folder.absolute() for folder in folders)
        place = ordered[0].parent
        names = [os.path.relpath(folder, place).replace(os.sep, "-") for folder in ordered]
        name = "+".join(names)
        if len(name.encode()) > _LONGEST_NAME:
            name = f"{names[0][:_SHORT_NAME]}+{len(names) - 1}-{hashlib.sha256(name.encode()).hexdigest()[:16]}"
        return place / f"{name}.{HISTORY_FILE}"
    if is_session_folder(folders[0]):
        return folders[0] / HISTORY_FILE
    recording = folders[0].absolute()
    return recording.with_name(f"{recording.name}.{HISTORY_FILE}")


def fingerprint(*sessions: Session) -> str:
    """Short text that changes with any reading; of several sessions the same in any order."""
    if len(sessions) > 1:
        every = "\0".join(sorted(fingerprint(session) for session in sessions))
        return f"sha256-{hashlib.sha256(every.encode()).hexdigest()[:16]}"
    (session,) = sessions
    readings = session.readings
    digest = hashlib.sha256(session.method.encode())
    of_each = picked(readings, "setup", "repeat", "displacement")
    for name, values in (*of_each.items(), *sorted(readings.columns.items())):
        digest.update(name.encode() + b"\0" + values.tobytes())
    for name, labels in sorted(readings.labels.items()):
        digest.update("\0".join([name, *(str(v) for v in labels)]).encode())
    return f"sha256-{digest.hexdigest()[:16]}"


def read_history(path: Path) -> History:
    """The history in a file; an empty one if there is no file.

    A SessionError names file, line and key of the first defect; the file is left as it is.
    """
    if not path.exists():
        return History()
    document = read_yaml(path, LARGEST_TABLE)
    if not isinstance(document.value, dict):
        raise SessionError(f"{path}: is no history of models; move it away to start a new one")
    try:
        return validated(History, document.value, str(path), document)
    except SessionError as error:
        raise SessionError(f"{error}; mend the file, or move it away to start a new history") from None


def update_history(path: Path, change: Callable[[History], History]) -> tuple[History, History]:
    """Read the history, change it, and put the new one in its place; the old one and the new.

    Whatever happens, the file holds the whole old history or the whole new one; two commands at once wait for each
    other. A SessionError if it is damaged, or cannot be written.
    """
    with writing(path, SessionError), _alone(path.parent):
        old = read_history(path)
        new = change(old)
        if new != old:
            _write(path, new)
    return old, new


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """One process at a time in a folder, where the system can tell."""
    try:
        import fcntl
    except ImportError:  # pragma: no cover - not on this system
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # some network drives cannot
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _write(path: Path, history: History) -> None:
    content = history.model_dump(mode="json")
    text = _HEAD + yaml.dump(content, Dumper=PlainDumper, sort_keys=False, width=120, allow_unicode=True)
    with whole(path, SessionError) as part, part.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


_FIGURES: dict[str, Callable[[Entry], str]] = {
    "head.variant": lambda one: one.model,
    "head.effects": lambda one: ", ".join(one.effects) or "–",
    "result.readings_used": lambda one: str(one.used),
    "history.set_aside": lambda one: str(one.readings_aside),
    "improved.rms": lambda one: micrometres(one.rms_residual),
    "result.chi": lambda one: rounded(one.reduced_chi_square),
    "history.freedom": lambda one: str(one.degrees_of_freedom),
    "improved.map": lambda one: of_map(one.map_rms, one.map_uncertainty_rms)[0],
    "history.U_map": lambda one: of_map(one.map_rms, one.map_uncertainty_rms)[1],
}
"""What is told of a model beside its coefficients, by the key of what it is."""


def tried_models(models: Sequence[Entry], current: int | None) -> TextTable:
    """Models of a history, one a row, with a mark at the one in use; a model stands twice where one went back to it."""
    known: dict[int | None, Entry] = {entry.number: entry for entry in models}
    return table(
        say("history.tried"),
        models,
        say("history.note"),
        model=lambda entry: f"{'→' if entry.number == current else ' '} {entry.number}",
        **{"from": lambda entry: "" if entry.parent is None else str(entry.parent)},
        made=lambda entry: entry.made.replace("T", " ")[:16],
        variant=lambda entry: entry.model,
        effects=lambda entry: ", ".join(entry.effects) or "–",
        change=lambda entry: entry.changed(known.get(entry.parent)),
        readings=lambda entry: str(entry.used),
        residual=lambda entry: micrometres(entry.rms_residual),
        chi=lambda entry: rounded(entry.reduced_chi_square),
        map_moves=lambda entry: micrometres(entry.map_change_rms),
    )


def compared_models(one: Entry, other: Entry) -> TextTable:
    """Two models side by side: figures first, then each coefficient with its expanded uncertainty."""
    both = (one, other)
    rows: list[tuple[str, ...]] = [(say(key), *map(shown, both)) for key, shown in _FIGURES.items()]
    known = [{p.name: p for p in entry.parameters} for entry in both]
    for name in dict.fromkeys([*known[0], *known[1]]):
        found = (k.get(name) for k in known)
        rows.append((name, *(quantity(p.value, p.unit, p.standard_uncertainty) if p else "–" for p in found)))
    columns = ("", *(say("history.model", n=entry.number) for entry in both))
    note = say("history.coefficients") if len(rows) > len(_FIGURES) else ""
    return TextTable(say("history.side"), columns, tuple(rows), note)
