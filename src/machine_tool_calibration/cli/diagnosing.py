# SPDX-License-Identifier: Apache-2.0
"""What the verbs that diagnose share: options, the model in use."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from machine_tool_calibration.cli.output import MOST_DRAWS, note, session_labels
from machine_tool_calibration.errors import CalibrationError, SessionError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from machine_tool_calibration.diagnosis.history import Entry
    from machine_tool_calibration.effects.effect import Effect
    from machine_tool_calibration.model.fit import JointFit
    from machine_tool_calibration.session.session import Session

__all__ = [
    "current_model",
    "current_models",
    "history_option",
    "keep_option",
    "keeping",
    "model_options",
    "no_model",
    "note_written",
    "own_effects",
    "search_options",
    "unused_model",
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
    sessions: Sequence[Session], paths: Sequence[Path], effects: Sequence[str] = (), model: str | None = None
) -> tuple[Entry, list[Session], list[NDArray[np.bool_]]]:
    """The same of one session or of several that are fitted together, in the order in which they are given.

    Args:
        sessions: as they were read; what they say to be sound is not left out.
        paths: where.
        effects: that the user asked for as well, which cannot be.
        model: likewise.

    Raises:
        UsageError: effects or a model were asked for.
        CalibrationError: no model was tried yet.
    """
    if effects or model:
        raise click.UsageError("--from-history is without --effect and --model.")
    import numpy as np

    from machine_tool_calibration.reports.history_file import fingerprint, history_path, read_history

    entry = read_history(history_path(*paths)).in_use
    if entry is None:
        raise no_model(paths)
    if entry.data != fingerprint(*sessions):
        note(f"the readings have changed since model {entry.number} was made of them")
    said = entry.of_sessions([fingerprint(session) for session in sessions], session_labels(paths))
    # What was put back belongs to the model, as what was set aside does.
    sessions = [
        session if own is None else session.keeping(set(own.kept).intersection(session.readings.row.tolist()))
        for session, own in zip(sessions, said, strict=True)
    ]
    rows = [
        [] if own is None else [row for row in own.set_aside if row not in session.sound]
        for session, own in zip(sessions, said, strict=True)
    ]
    asides = [np.isin(session.readings.row, own) for session, own in zip(sessions, rows, strict=True)]
    kept = [session.without(aside) if aside.any() else session for session, aside in zip(sessions, asides, strict=True)]
    return entry, kept, asides


def unused_model(
    sessions: Sequence[Session],
    paths: Sequence[Path],
    effects: Collection[str],
    fit: JointFit | None,
    *,
    effects_only: bool = False,
) -> str | None:
    """That the sessions' history holds a better model than the one used, and how to use it; None if it does not.

    Args:
        sessions: with all their readings; several have a history of their own.
        paths: where they were read; the history is in it or beside it.
        effects: ids in the model that was used.
        fit: of that model; None if it is of other readings too, so that no figures can be compared.
        effects_only: whether to say how by effects, as for several sessions together.
    """
    from machine_tool_calibration.reports.history_file import fingerprint, history_path, read_history
    from machine_tool_calibration.reports.quantities import rounded

    kept = history_path(*paths)
    try:
        entry = read_history(kept).in_use
    except SessionError as error:
        return f"warning: {error}"
    if entry is None or entry.data != fingerprint(*sessions):
        return None
    more = [name for name in entry.effects if name not in effects]
    aside = 0 if effects_only else entry.readings_aside
    if not more and not aside:
        return None
    chi = entry.reduced_chi_square
    fell = ""
    if fit is not None and chi is not None:
        if chi >= fit.reduced_chi_square:
            return None
        fell = f" (reduced chi-square {rounded(chi)} instead of {rounded(fit.reduced_chi_square)})"
    what = [", ".join(more)] if more else []
    what += [f"{aside} reading{'' if aside == 1 else 's'} set aside"] if aside else []
    how = " ".join(f"--effect {name}" for name in more) if effects_only else "--from-history"
    return (
        f"note: {kept} holds a better model, number {entry.number}, with {' and '.join(what)}{fell}; "
        f"it was not used: {how} does"
    )


def no_model(paths: Sequence[Path]) -> CalibrationError:
    """That no model was tried yet, and what begins."""
    named = " ".join(str(path) for path in paths)
    return CalibrationError(f"{named}: no model was tried yet; `mtcal improve {named}` begins")


Command = TypeVar("Command", bound=Callable[..., Any])


def keep_option(function: Command) -> Command:
    """Add `--keep`."""
    return click.option(
        "--keep",
        "keep",
        metavar="[SESSION:]ROW",
        multiple=True,
        help="Reading that is not to be set aside, as the table of those set aside names it; repeatable.",
    )(function)


def history_option(function: Command) -> Command:
    """Add `--from-history`."""
    return click.option(
        "--from-history",
        is_flag=True,
        help="Model, effects and outliers as in the session's current model (`mtcal improve`, `mtcal history`).",
    )(function)


def keeping(sessions: Sequence[Session], paths: Sequence[Path], keep: Sequence[str]) -> list[Session]:
    """The sessions, with the readings that `--keep` names known to be sound.

    Args:
        sessions: as they were read.
        paths: where.
        keep: `ROW`, or of several sessions `SESSION:ROW`.

    Raises:
        CalibrationError: not a row, no such session or no such reading.
    """
    labels = session_labels(paths)
    out = list(sessions)
    for text in keep:
        label, _, row = text.rpartition(":")
        if not row.isdecimal() or (label and label not in labels) or (not label and len(labels) > 1):
            known = " or ".join(f"{name}:ROW" for name in labels) if len(labels) > 1 else "ROW"
            raise CalibrationError(f"--keep {text}: give {known}, a number from 0")
        k = labels.index(label) if label else 0
        out[k] = out[k].keeping([int(row)])
    return out


def model_options(function: Command) -> Command:
    """Add `--effect`, `--effects-file`, `--model` and `--keep`."""
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
        keep_option,
    ):
        function = option(function)
    return function


def search_options(function: Command) -> Command:
    """Add `--seed` and `--sets`."""
    for option in (
        click.option(
            "--sets",
            type=click.IntRange(199, MOST_DRAWS),
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
