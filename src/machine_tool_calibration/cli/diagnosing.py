# SPDX-License-Identifier: Apache-2.0
"""What the verbs that diagnose share: options, the model in use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from machine_tool_calibration.cli.output import note, session_labels
from machine_tool_calibration.errors import CalibrationError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from machine_tool_calibration.diagnosis.history import Entry
    from machine_tool_calibration.effects.effect import Effect
    from machine_tool_calibration.session.session import Session

__all__ = [
    "current_model",
    "current_models",
    "model_options",
    "no_model",
    "note_written",
    "own_effects",
    "search_options",
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
    import numpy as np

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


def model_options(function: Command) -> Command:
    """Add `--effect`, `--effects-file` and `--model`."""
    for option in (
        click.option("--model", help="Variant of the model, such as free; `mtcal info SESSION` says when which."),
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
            help="Simulated data sets in which nothing is missing: they give the p-values.",
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


def note_written(paths: Sequence[Path]) -> None:
    """Say on standard error what was written."""
    if paths:
        note(f"wrote {', '.join(str(path) for path in paths)}")
