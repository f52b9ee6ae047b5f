# SPDX-License-Identifier: Apache-2.0
"""`mtcal logbook`: every session that was measured on a machine, with its result, in one file."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from machine_tool_calibration.cli import shared
from machine_tool_calibration.cli.diagnosing import Wanted, model_options
from machine_tool_calibration.reports.documents import picked
from machine_tool_calibration.words import say

if TYPE_CHECKING:
    from machine_tool_calibration.trends.logbook import Withdrawn

machine_option = click.option("--machine", help="The machine, where a logbook has several.")


@click.group("logbook")
def command() -> None:
    """Keep a machine's logbook: every session with its result, none ever changed.

    BOOK is one file (SQLite). Each entry has machine, date, instrument, the data's SHA-256, the software that evaluated
    it, the result document, the sizes of all errors and the readings themselves. `mtcal check` and `mtcal trend` read
    it.

    \b
    mtcal logbook add mill.logbook january february march
    mtcal logbook list mill.logbook
    mtcal logbook withdraw mill.logbook 2 --why "measured on the other mill"
    """


@command.command("add")
@click.argument("book", type=shared.FILE)
@click.argument("sessions", metavar="SESSION…", nargs=-1, required=True, type=shared.PATH)
@click.option("--machine", help="Name of the machine, where `about` in session.yaml does not say it, or wrongly.")
@click.option("--date", help="When it was measured (ISO 8601), where `about` does not say it, or wrongly.")
@click.option("--instrument", help="Which instrument read, such as a serial number, likewise.")
@model_options
@shared.json_option
def add(
    book: Path,
    sessions: tuple[Path, ...],
    machine: str | None,
    date: str | None,
    instrument: str | None,
    wanted: Wanted,
    as_json: bool,
) -> None:
    """Identify sessions, each by itself, and enter them with their results.

    A session that is in BOOK already, by the SHA-256 of its data, is said and changes nothing.
    """
    from machine_tool_calibration.session.provenance import name_of_machine
    from machine_tool_calibration.trends.logbook import Logbook, entry_of
    from machine_tool_calibration.trends.statement import sizes_of

    if date is not None and len(sessions) > 1:
        raise click.UsageError("--date is for one SESSION.")
    said: list[dict[str, object]] = []
    for path, label in zip(sessions, shared.session_labels(sessions), strict=True):
        with shared.progress_bar() as progress:
            fit = wanted.fit([path], progress)
            sizes = sizes_of(fit.result, progress)
        session, about = fit.measurement.sessions[0], {"machine": machine, "date": date, "instrument": instrument}
        stated = name_of_machine(session.description.about)
        if machine and stated and machine.strip() != stated.strip():
            shared.note(say("logbook.instead", label=label, machine=machine, stated=stated))
        told, added = Logbook(book).add(entry_of(session, label, fit.document(), sizes, **about))
        said.append({"label": label, "added": added, "number": told.number, "sha256": told.sha256})
        if not as_json:
            key, values = "logbook.added" if added else "logbook.there", picked(told, "machine", "date")
            values |= {"label": label, "n": told.number, "sum": told.sha256[:12], "count": len(told.sizes)}
            shared.console().print(say(key, **values))
    if as_json:
        shared.write_json({"format": "mtcal-logbook-added/1", "book": str(book), "sessions": said})


@command.command("withdraw")
@click.argument("book", type=shared.FILE)
@click.argument("number", type=click.IntRange(min=1))
@click.option("--why", required=True, help="Why the entry counts no more; it is shown in the list.")
@shared.json_option
def withdraw(book: Path, number: int, why: str, as_json: bool) -> None:
    """Withdraw an entry that was wrong: it stays in BOOK with the reason, and counts no more.

    Its session can be entered again, with its right machine and date.
    """
    from machine_tool_calibration.trends.logbook import Logbook

    if not why.strip():
        raise click.UsageError("--why is empty.")
    gone = Logbook(book).withdraw(number, why)
    document = {"format": "mtcal-logbook-withdrawn/1", "book": str(book), **asdict(gone)}
    shared.tell_either(document, [_said(gone)], as_json)


def _said(gone: Withdrawn) -> str:
    return say("logbook.withdrawn", label=gone.label, n=gone.number, why=gone.why)


@command.command("list")
@click.argument("book", type=shared.FILE)
@machine_option
@shared.json_option
def listed(book: Path, machine: str | None, as_json: bool) -> None:
    """List the entries of a logbook by date, and what was withdrawn of it."""
    from machine_tool_calibration.reports.trends import entries_table
    from machine_tool_calibration.trends.logbook import Logbook

    entries, withdrawn = Logbook(book).entries(machine), Logbook(book).withdrawn()
    document = {
        "format": "mtcal-logbook/1",
        "book": str(book),
        "entries": [one.document() for one in entries],
        "withdrawn": [asdict(one) for one in withdrawn],
    }
    shared.tell_either(document, [entries_table(entries), *map(_said, withdrawn)], as_json)
