# SPDX-License-Identifier: Apache-2.0
"""`mtcal fleet`: all machines of a logbook, and which of them need attention."""

from functools import partial
from pathlib import Path
from typing import Any

import click

from machine_tool_calibration.cli.diagnosing import Wanted, fit_one, followed, model_options, workers_options
from machine_tool_calibration.cli.shared import FILE, FOLDER, json_option, note, note_written, tell
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.words import words


@click.command("fleet")
@click.argument("book", type=FILE)
@click.argument("folders", metavar="[FOLDER…]", nargs=-1, type=FOLDER)
@click.option("-o", "--output", type=FOLDER, help="Folder for the page (fleet.html) and the numbers as Parquet files.")
@click.option(
    "--limit", "limits", metavar="NAME=VALUE", multiple=True, help="Attention beyond it, such as EXX=5um; repeatable."
)
@click.option("--largest-u", metavar="VALUE", help="Attention where U (95 %) of a length is more, such as 3um.")
@click.option("--language", default="en", show_default=True, metavar="en|de", help="Of the page.")
@model_options
@workers_options
@json_option
def command(
    book: Path,
    folders: tuple[Path, ...],
    output: Path | None,
    limits: tuple[str, ...],
    largest_u: str | None,
    language: str,
    wanted: Wanted,
    as_json: bool,
    **cluster: Any,
) -> None:
    """Say which of many machines need attention, why, and which effects occur where.

    BOOK is a logbook (`mtcal logbook`), which is made where it is missing. Every session in and below the FOLDERs that
    it does not have yet is identified, diagnosed and entered, each by itself and as soon as it is finished: what was
    interrupted goes on where it ended. Machine and date are those of `about` in session.yaml, or the folders
    MACHINE/DATE. Then the whole logbook is judged: what the last session's model lacks, what jumped or drifts, what is
    beyond a limit or too uncertain.

    \b
    mtcal fleet shop.logbook measurements -o fleet
    mtcal fleet shop.logbook --limit volumetric=20um --limit C0Y=30urad --largest-u 3um
    mtcal fleet shop.logbook measurements --scheduler tcp://10.0.0.5:8786
    """
    from machine_tool_calibration.budget.tolerances import parse_tolerances, tolerance
    from machine_tool_calibration.fleet.fleet import Fleet
    from machine_tool_calibration.fleet.machines import judged
    from machine_tool_calibration.fleet.page import write_page
    from machine_tool_calibration.fleet.parquet import machine_tables, write_tables
    from machine_tool_calibration.trends.logbook import Logbook

    if wanted.keep:
        raise click.UsageError("--keep is for one session (mtcal logbook add).")
    spoken, kept = words(language), parse_tolerances(limits)
    most = None if largest_u is None else tolerance("volumetric", largest_u)
    added, problems = _enter(book, folders, wanted, **cluster) if folders else (0, [])
    logbook = Logbook(book)
    entries = logbook.entries() if book.exists() or not folders else ()
    found = judged(entries, logbook.diagnoses(), limits=kept, largest_u=most, problems=problems, added=added)
    written = []
    if output is not None:
        written = [write_page(found, book, output / "fleet.html", spoken), *write_tables(machine_tables(found), output)]
    tell(Fleet.of(found), as_json)
    note_written(written)


def _enter(book: Path, folders: tuple[Path, ...], wanted: Wanted, **cluster: Any) -> tuple[int, list[tuple[str, str]]]:
    """Evaluate and enter the sessions that the logbook does not have; how many, and what failed."""
    from machine_tool_calibration.fleet.each import each
    from machine_tool_calibration.fleet.sessions import evaluated, is_known, places
    from machine_tool_calibration.trends.logbook import Logbook

    logbook, problems, added = Logbook(book), list[tuple[str, str]](), 0
    entered, withdrawn = set[str](), set[str]()
    if book.exists():
        entered = {one.sha256 for one in logbook.entries()}
        withdrawn = {one.sha256 for one in logbook.withdrawn()}  # they are not entered as they were
    known = frozenset(entered & set(logbook.diagnoses()) | withdrawn)
    found = places(folders)
    new = [place for place in found if not (known and is_known(place, known))]
    if len(new) < len(found):
        note(f"{len(found) - len(new)} of {len(found)} sessions are in {book} already")
    work = partial(evaluated, fit=partial(fit_one, wanted=wanted))
    for one in followed(each(work, new, **cluster), len(new)):
        if one.found is None:
            problems.append((one.item.label, one.item.told(one.problem)))
            continue
        # The diagnosis first: what has an entry is finished.
        logbook.add_diagnosis(one.found.entry.sha256, one.found.diagnosis)
        try:
            added += logbook.add(one.found.entry)[1]
        except SessionError as error:
            problems.append((one.item.label, str(error)))
    return added, problems
