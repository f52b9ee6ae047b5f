"""What the verbs that diagnose share: options, the progress bar, tables."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, TypeVar

import click
import numpy as np

from machine_tool_calibration.cli.output import error_console, note, session_labels
from machine_tool_calibration.errors import CalibrationError

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rich.console import Console

    from machine_tool_calibration.diagnosis.history import Entry
    from machine_tool_calibration.effects.effect import Effect
    from machine_tool_calibration.reports.diagnosis import TextTable
    from machine_tool_calibration.session.session import Session

__all__ = [
    "bar",
    "current_model",
    "current_models",
    "model_options",
    "no_model",
    "own_effects",
    "saved",
    "search_options",
    "show_table",
]


def current_model(session: Session, path: Path) -> tuple[Entry, Session, NDArray[np.bool_]]:
    """The model in use of a session, its readings without those that were set aside, and which those are.

    Args:
        session: as it was read.
        path: where it was read; the history is in it or beside it.

    Returns:
        The entry of the history, the session to fit, and for each reading whether it is left out.

    Raises:
        CalibrationError: no model was tried yet.
    """
    entry, (kept,), (aside,) = current_models([session], [path])
    return entry, kept, aside


def current_models(
    sessions: Sequence[Session], paths: Sequence[Path]
) -> tuple[Entry, list[Session], list[NDArray[np.bool_]]]:
    """The same of one session or of several that are fitted together, in the order in which they are given.

    Raises:
        CalibrationError: no model was tried yet.
    """
    from machine_tool_calibration.reports.history_file import fingerprint, history_path, read_history

    entry = read_history(history_path(*paths)).in_use
    if entry is None:
        raise no_model(paths)
    if entry.data != fingerprint(*sessions):
        note(f"the readings have changed since model {entry.number} was made of them")
    rows = [entry.set_aside]
    if len(sessions) > 1:
        by_data = {part.data: part.set_aside for part in entry.sessions}
        by_label = {part.label: part.set_aside for part in entry.sessions}
        labels = session_labels(paths)
        rows = [
            by_data.get(fingerprint(session), by_label.get(label, ()))
            for session, label in zip(sessions, labels, strict=True)
        ]
    asides = [np.isin(session.readings.row, own) for session, own in zip(sessions, rows, strict=True)]
    kept = [
        session.with_readings(session.readings.select(~aside)) if aside.any() else session
        for session, aside in zip(sessions, asides, strict=True)
    ]
    return entry, kept, asides


def no_model(paths: Sequence[Path]) -> CalibrationError:
    """That no model was tried yet, and what begins."""
    named = " ".join(str(path) for path in paths)
    return CalibrationError(f"{named}: no model was tried yet; `mtcal improve {named}` begins")


Command = TypeVar("Command", bound=Callable[..., Any])
# Longest text that a column keeps on one line.
_UNBROKEN = 24
# Between two columns; what a column of longer text needs to be read with ease; and the least that it can do with.
_GAP = 2
_EASE, _FOLDED = 24, 8
# How narrow a heading becomes before any is broken at every word.
_HEAD = 10
# A column of nothing else stands to the right, so that places stand below each other.
_NUMBER = re.compile(r"[-+−]?[\d.:]+(e[-+]\d+)?( ?%)?|< ?[\d.e-]+|–")


def model_options(function: Command) -> Command:
    """Add `--effect`, `--effects-file` and `--model`."""
    for option in (
        click.option("--model", help="Variant of the method's model, such as free or rigid_body."),
        click.option(
            "--effects-file",
            "files",
            type=click.Path(path_type=Path, dir_okay=False),
            multiple=True,
            help="YAML file with effects of your own; they are looked for like the built-in ones.",
        ),
        click.option(
            "-e", "--effect", "effects", multiple=True, metavar="ID", help="Effect that is in the model already."
        ),
    ):
        function = option(function)
    return function


def search_options(function: Command) -> Command:
    """Add `--seed` and `--sets`."""
    for option in (
        click.option(
            "--sets",
            type=click.IntRange(min=199),
            default=199,
            show_default=True,
            help="Simulated data sets in which nothing is missing: they check how often chance does as well.",
        ),
        click.option(
            "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of the simulated data sets."
        ),
    ):
        function = option(function)
    return function


def own_effects(files: Sequence[Path]) -> list[Effect]:
    """The user's own effects from their files."""
    if not files:
        return []
    from machine_tool_calibration.effects.formula import read_effects

    return [effect for file in files for effect in read_effects(file)]


@contextmanager
def bar() -> Iterator[Callable[[str, float], None]]:
    """A progress bar on standard error; nothing where that is not a terminal."""
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    screen = error_console()
    if not screen.is_terminal:
        yield lambda what, share: None
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=screen, transient=True) as shown:
        task = shown.add_task("reading", total=1.0)
        yield lambda what, share: shown.update(task, description=what, completed=share)


def show_table(screen: Console, table: TextTable) -> None:
    """Print a table of text; columns without any text are left out, numbers stand to the right."""
    from rich.table import Table
    from rich.text import Text

    shown = Table(box=None, header_style="bold", pad_edge=False)
    used = [k for k in range(len(table.columns)) if any(row[k] for row in table.rows)]
    longest = {k: max((len(row[k]) for row in table.rows), default=0) for k in used}
    heads = {k: table.columns[k] for k in used}
    unbroken = {k for k in used if longest[k] <= _UNBROKEN}

    def missing(folded: int) -> int:
        # What rich may still break counts as if it could become so narrow.
        texts = {k: longest[k] if k in unbroken else min(longest[k], folded) for k in used}
        widths = (max(texts[k], *(len(line) for line in heads[k].split("\n"))) for k in used)
        return sum(widths) + _GAP * (len(used) - 1) - screen.width

    # rich cuts columns that must not break where the table is too wide: break headings first, then the longest texts.
    for narrow in (_HEAD, 1):
        if missing(_EASE) > 0:
            heads = {k: fill(table.columns[k], max(longest[k], narrow), break_long_words=False) for k in used}
    for k in sorted(unbroken, key=lambda k: longest[k], reverse=True):
        if missing(_FOLDED) > 0:
            unbroken.discard(k)
    for k in used:
        numbers = all(_NUMBER.fullmatch(row[k]) for row in table.rows if row[k])
        shown.add_column(Text(heads[k]), overflow="fold", no_wrap=k in unbroken, justify="right" if numbers else "left")
    for row in table.rows:
        shown.add_row(*(Text(row[k]) for k in used))
    screen.print()
    screen.print(Text(table.title, style="bold"))
    screen.print(shown)
    if table.note:
        screen.print(Text(f"({table.note})", style="dim"))


def saved(paths: Sequence[Path]) -> None:
    """Say on standard error what was written."""
    if paths:
        note(f"wrote {', '.join(str(path) for path in paths)}")
