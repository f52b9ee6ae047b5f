# SPDX-License-Identifier: Apache-2.0
"""What the verbs that diagnose share: options, the model in use."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from machine_tool_calibration.cli.shared import FILE, PATH, Progress, bar, note, options, session_labels
from machine_tool_calibration.errors import CalibrationError, ModelError, SessionError
from machine_tool_calibration.progress import untold

if TYPE_CHECKING:
    from machine_tool_calibration.interface.identification import Fit
    from machine_tool_calibration.methods.fitted import FitRequest
    from machine_tool_calibration.reports.identification import Measured
    from machine_tool_calibration.session.session import Session

# Share of a reduced chi-square below which another one is better, and not another of its look-alikes.
_CLEARLY_LESS = 0.999


@dataclass(frozen=True)
class Wanted:
    """The model that the options of `model_options` ask for."""

    effects: tuple[str, ...]  # ids of the effects in it
    files: tuple[Path, ...]  # YAML files with effects of the user's own
    model: str | None  # variant of the method's model; None for its default
    keep: tuple[str, ...]  # readings that are not to be set aside, as `--keep` names them
    from_history: bool = False  # whether it is the one in use of the history

    def open(self, paths: Sequence[Path], topics: dict[str, str] | None = None) -> Measured:
        """Read measurements (one, or several that are fitted together), and choose the model to fit to them.

        The history is in them or beside them; `topics` are names by their role, for recordings. A UsageError if effects
        or a model were asked for beside those of the history; a CalibrationError if a measurement cannot be read,
        `--keep` names no reading of it, or no model was tried yet.
        """
        from machine_tool_calibration.effects.catalogue import own_effects
        from machine_tool_calibration.methods.fitted import FitRequest
        from machine_tool_calibration.recording.open import open_measurement
        from machine_tool_calibration.reports.identification import Measured
        from machine_tool_calibration.session.session import refuse_repeated

        own, labels = own_effects(self.files), session_labels(paths)
        recorded = tuple(open_measurement(path, topics) for path in paths)
        sessions = tuple(keeping(recorded, labels, self.keep))
        refuse_repeated(sessions, labels)
        if not self.from_history:
            asked = FitRequest(sessions, tuple(labels), self.model, self.effects, tuple(own))
            self._note_idle(replace(asked, sessions=recorded), sessions, labels)
            return Measured(sessions, asked)
        if self.effects or self.model:
            raise click.UsageError("--from-history is without --effect and --model.")
        from machine_tool_calibration.effects.catalogue import find_effects
        from machine_tool_calibration.reports.history import fingerprint, history_path, read_history

        history = read_history(history_path(*paths))
        if (entry := history.in_use) is None:
            raise no_model(paths)
        if entry.data != fingerprint(*sessions):
            note(f"the readings have changed since model {entry.number} was made of them")
        prints = [fingerprint(session) for session in sessions]
        try:
            self._note_idle(entry.request(recorded, labels, prints, own), sessions, labels)
            chosen = entry.request(sessions, labels, prints, own)
            instead = {name for others in chosen.alternatives.values() for name in others}
            find_effects([*chosen.effects, *instead], chosen.own)
        except ModelError as error:
            raise ModelError(f"{history_path(*paths)}: model {entry.number}: {error}") from None
        return Measured(sessions, chosen, history.way_to(entry.number))

    def _note_idle(self, without: FitRequest, kept: Sequence[Session], labels: Sequence[str]) -> None:
        """Say which readings that `--keep` names the model does not set aside `without` it either."""
        from machine_tool_calibration.methods.fitted import gross_errors

        if not self.keep:
            return
        looked = [] if without.keep_all else gross_errors(without)  # a model of the history has set aside its own
        aside = [{one.row for one in own.outliers} for own in looked] or [set[int]() for _ in kept]
        for label, session, before, gone in zip(labels, kept, without.sessions, aside, strict=True):
            for row in sorted(session.sound.intersection(before.readings.row.tolist()) - gone):
                named = f"{label}:{row}" if len(labels) > 1 else row
                note(f"note: --keep {named}: this model does not set the reading aside anyway")

    def have_history(self, paths: Sequence[Path]) -> list[bool]:
        """Of which measurements the history is asked for, and has a model; a CalibrationError if none that is asked."""
        from machine_tool_calibration.reports.history import history_path, read_history

        out = [self.from_history and read_history(history_path(path)).in_use is not None for path in paths]
        if self.from_history and not any(out):
            raise no_model(paths)
        return out

    def fit(
        self,
        paths: Sequence[Path],
        progress: Progress,
        choose: Callable[[Measured], FitRequest] = lambda measured: measured.chosen,
        topics: dict[str, str] | None = None,
    ) -> Fit:
        """Read measurements as by `open`, and identify as `mtcal identify` does, by the model that `choose` takes.

        A CalibrationError as for `open`, or if the data does not allow the model.
        """
        from machine_tool_calibration.interface.identification import fitted
        from machine_tool_calibration.interface.session import Measurement

        measured = self.open(paths, topics)
        progress("identifying", None)
        measurement = Measurement(measured.recorded, tuple(session_labels(paths)))
        return fitted(measurement, choose(measured), measured.history)

    def note_unused(self, fit: Fit, paths: Sequence[Path]) -> None:
        """Say that the history of the sessions holds a better model, where it was not asked for, and how to use it."""
        from machine_tool_calibration.reports.history import fingerprint, history_path, read_history
        from machine_tool_calibration.reports.quantities import rounded

        if self.from_history:
            return
        kept = history_path(*paths)
        try:
            entry = read_history(kept).in_use
        except SessionError as error:
            note(f"warning: {error}")
            return
        if entry is None or entry.data != fingerprint(*fit.measurement.sessions):
            return
        more, aside = [name for name in entry.effects if name not in fit.effects], entry.readings_aside
        chi, now = entry.reduced_chi_square, fit.reduced_chi_square
        if not (more or aside) or (chi is not None and chi >= _CLEARLY_LESS * now):
            return
        what = [", ".join(more)] if more else []
        what += [f"{aside} reading{'' if aside == 1 else 's'} set aside"] if aside else []
        fell = "" if chi is None else f" (reduced chi-square {rounded(chi)} instead of {rounded(now)})"
        note(
            f"note: {kept} holds a better model, number {entry.number}, with {' and '.join(what)}{fell}; "
            "it was not used: --from-history does"
        )


def no_model(paths: Sequence[Path]) -> CalibrationError:
    """That no model was tried yet, and what begins."""
    named = " ".join(str(path) for path in paths)
    return CalibrationError(f"{named}: no model was tried yet; `mtcal improve {named}` begins")


def keeping(sessions: Sequence[Session], labels: Sequence[str], keep: Sequence[str]) -> list[Session]:
    """The sessions, with the readings that `--keep` names known to be sound; a CalibrationError if it names none."""
    out = list(sessions)
    for text in keep:
        label, _, row = text.rpartition(":")
        if not row.isdecimal() or (label and label not in labels) or (not label and len(labels) > 1):
            known = " or ".join(f"{name}:ROW" for name in labels) if len(labels) > 1 else "ROW"
            raise CalibrationError(f"--keep {text}: give {known}, a number from 0")
        k = labels.index(label) if label else 0
        out[k] = out[k].keeping([int(row)])
    return out


sessions_argument = click.argument("measurements", metavar="SESSION…", nargs=-1, required=True, type=PATH)
model_option = click.option("--model", help="Variant of the model, such as free; `mtcal info SESSION` says when which.")
effect_option = click.option(
    "-e", "--effect", "effects", multiple=True, metavar="ID", help="Effect to have in the model; repeatable."
)
effects_file_option = click.option(
    "--effects-file",
    "files",
    type=FILE,
    multiple=True,
    help="YAML file with effects of your own; they are looked for like the built-in ones.",
)
_history_option = click.option(
    "--from-history",
    is_flag=True,
    help="Model, effects and outliers as in the session's current model (`mtcal improve`, `mtcal history`).",
)
_new_model_options = options(
    click.option(
        "--keep",
        metavar="[SESSION:]ROW",
        multiple=True,
        help="Reading that is not to be set aside, as the table of those set aside names it; repeatable.",
    ),
    effect_option,
    effects_file_option,
    model_option,
)


def new_model_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Add `--effect`, `--effects-file`, `--model` and `--keep` to a verb, as the keyword argument `wanted`."""

    @wraps(function)
    def collected(**given: Any) -> Any:
        wanted = Wanted(**{one.name: given.pop(one.name) for one in fields(Wanted) if one.name in given})
        return function(wanted=wanted, **given)

    return _new_model_options(collected)


def model_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same with `--from-history`."""
    return new_model_options(_history_option(function))


One = TypeVar("One")
_LINE = 30.0  # seconds between two lines where there is no terminal for a bar

workers_options = options(
    click.option(
        "--workers",
        type=click.IntRange(min=0),
        help="Processes of this machine, by default one a processor; 0: one session after the other, without Dask.",
    ),
    click.option(
        "--scheduler", metavar="ADDRESS", help="Of a Dask cluster that works instead, such as tcp://host:8786."
    ),
)
"""`workers` and `scheduler` of `fleet.each.each`."""


def fit_one(path: Path, wanted: Wanted, *, keep_all: bool = False) -> Fit:
    """Identify one of many sessions; the variant of the model is for those of methods that have it."""
    return wanted.fit([path], untold, partial(_chosen, wanted, keep_all))


def _chosen(wanted: Wanted, keep_all: bool, measured: Measured) -> FitRequest:
    from machine_tool_calibration.session.catalogue import method_names, method_spec, spec_of

    chosen = measured.chosen
    elsewhere = {model for name in method_names() for model in method_spec(name).models}
    # One that no method has is left for the refusal.
    if wanted.model and wanted.model in elsewhere and wanted.model not in spec_of(chosen.sessions[0]).models:
        chosen = replace(chosen, model=None)
    return replace(chosen, keep_all=keep_all or chosen.keep_all)


def followed(finished: Iterable[One], count: int) -> Iterator[One]:
    """The same, with how many of `count` are finished and the time that is left, on standard error."""
    from machine_tool_calibration.reports.quantities import duration

    begun = said = time.monotonic()
    with bar("sessions", counted=True) as update:
        for done, one in enumerate(finished, start=1):
            yield one
            now = time.monotonic()
            left = f"{duration((now - begun) / done * (count - done))} left"
            if update is not None:
                update(description=f"sessions, {left}", completed=done, total=count)
            elif now - said >= _LINE and done < count:
                said = now
                note(f"{done} of {count} sessions, {left}")
