# SPDX-License-Identifier: Apache-2.0
"""What is worked out of each of many sessions: its result, and for a logbook its sizes and its diagnosis."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

import pandas as pd

from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.interface.identification import Fit
from machine_tool_calibration.json_types import plain
from machine_tool_calibration.model.result import effect_estimates
from machine_tool_calibration.recording.open import open_measurement
from machine_tool_calibration.reports.result_tables import tidy
from machine_tool_calibration.session import DESCRIPTION_FILE, OBSERVATIONS_FILE
from machine_tool_calibration.session.provenance import data_hash, name_of_machine
from machine_tool_calibration.trends.logbook import Entry, entry_of
from machine_tool_calibration.trends.statement import sizes_of

Fitting = Callable[[Path], Fit]
"""Identifies a session by the model that was asked for."""


@dataclass(frozen=True, order=True)
class Place:
    """A session folder."""

    label: str  # its name among all: the path from the folder in which all of them are
    path: Path  # where it is

    def told(self, problem: str) -> str:
        """A problem of it without the path that the label stands for."""
        return problem.replace(f"{self.path}{os.sep}", "")


@dataclass(frozen=True)
class Identified:
    """One session's result."""

    document: dict[str, Any]  # `mtcal-result/1`
    values: pd.DataFrame  # everything that was found, one value a row (`reports.result_tables.tidy`)


@dataclass(frozen=True)
class Evaluated:
    """One session, as a logbook keeps it."""

    entry: Entry  # with its result and the sizes of all errors
    # `verdict`, `effects` that are missing, each with its `probability` and its `parameters` beside the others,
    # `likely` ones, and how many `outliers` there are
    diagnosis: dict[str, Any]


def places(folders: Sequence[Path]) -> list[Place]:
    """Session folders in folders and below, by their labels; a SessionError: no such folder, or no session in one."""
    found: dict[Path, Place] = {}
    root = Path(os.path.commonpath([folder.absolute() for folder in folders]))
    for folder in folders:
        if not folder.is_dir():
            raise SessionError(f"{folder}: no such folder")
        if not (own := sorted(_below(folder))):
            raise SessionError(f"{folder}: no session ({DESCRIPTION_FILE}, {OBSERVATIONS_FILE}) in it or below it")
        for path in own:
            label = str(path.absolute().relative_to(root))
            found.setdefault(path.resolve(), Place(root.name if label == "." else label, path))
    return sorted(found.values())


def _below(folder: Path) -> Iterator[Path]:
    """Session folders in a folder and below, links to folders followed, each real folder once and by its own name."""
    seen = set[Path]()
    for at, folders, files in os.walk(folder, followlinks=True):
        if (real := Path(at).resolve()) in seen:
            folders.clear()
            continue
        seen.add(real)
        folders.sort(key=lambda name: Path(at, name).is_symlink())  # noqa: B023: sorted here and now
        if {DESCRIPTION_FILE, OBSERVATIONS_FILE}.intersection(files):
            yield Path(at)


def identified(place: Place, fit: Fitting) -> Identified:
    """Identify a session; a CalibrationError if it cannot be read, or does not allow the model."""
    found = fit(place.path)
    return Identified(found.document(), tidy(found.result))


def evaluated(place: Place, fit: Fitting) -> Evaluated:
    """Identify and diagnose a session.

    Machine and date are those of `about`, else those of folders named MACHINE/DATE. A CalibrationError as for
    `identified`, or nothing says which machine it is, or when it was measured.
    """
    found = fit(place.path)
    session = found.measurement.sessions[0]
    about = session.description.about
    machine = date = None
    with suppress(ValueError):
        named = datetime.fromisoformat(place.path.name).date().isoformat()
        date = None if about.get("date") or about.get("time") else named
        machine = None if name_of_machine(about) else place.path.absolute().parent.name
    # What nothing says there is told before the long part begins.
    entry = entry_of(session, place.label, found.document(), (), machine=machine, date=date)
    return Evaluated(replace(entry, sizes=sizes_of(found.result)), _told(found.diagnose()))


def is_known(place: Place, known: frozenset[str]) -> bool:
    """Whether a session is among those whose SHA-256 is known; not where it cannot be read."""
    with suppress(OSError):
        files = (place.path / name for name in (DESCRIPTION_FILE, OBSERVATIONS_FILE))
        # As this package writes them: the sum is that of the data, and nothing needs to be read.
        if sha256(b"".join(file.read_bytes() for file in files)).hexdigest() in known:
            return True
    try:
        return data_hash(open_measurement(place.path)) in known
    except (CalibrationError, OSError):
        return False


def _told(found: Diagnosis) -> dict[str, Any]:
    sizes = effect_estimates(found.fits[-1], found.accepted) if found.accepted else ()
    effects = [
        {
            "effect": name,
            "probability": found.search.of(name).probability,
            "parameters": [size.document() for size in sizes if size.owner == name],
        }
        for name in found.accepted
    ]
    told = {"verdict": found.verdict, "effects": effects, "likely": found.likely}
    return dict(plain({**told, "outliers": len(found.gross_errors)}))
