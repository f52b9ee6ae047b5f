# SPDX-License-Identifier: Apache-2.0
"""What one window works on: the measurement, the models that were tried on the way, and the one in use."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from machine_tool_calibration.diagnosis.compare import compare
from machine_tool_calibration.diagnosis.comparison import Comparison
from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.diagnosis.history import Entry, History
from machine_tool_calibration.diagnosis.improve import Step, entry_of, step_after
from machine_tool_calibration.effects.effect import Effect as PhysicalEffect
from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.interface.identification import Fit
from machine_tool_calibration.interface.session import Measurement, load
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.result import EffectSet
from machine_tool_calibration.planning.what_to_measure import SEARCH, Conclusions, conclude
from machine_tool_calibration.reports.history_file import fingerprint, history_path, read_history, update_history
from machine_tool_calibration.session.session import Session

__all__ = ["Model", "State", "measurements_in"]


def measurements_in(folder: Path) -> list[Path]:
    """Sessions and recordings that lie in a folder, itself first if it is one."""
    from machine_tool_calibration.recording.open import is_session_folder
    from machine_tool_calibration.recording.reader import is_bag

    def holds(path: Path) -> bool:
        return is_session_folder(path) or is_bag(path)

    if folder.is_file() or holds(folder):
        return [folder]
    return sorted(path for path in folder.iterdir() if holds(path)) if folder.is_dir() else []


@dataclass(frozen=True)
class Model:
    """A model that was tried.

    Attributes:
        fit: to the readings that are not set aside.
        step: what it is on the way.
        comparison: it, held against its readings.
        number: in the history; None while it is not kept.
    """

    fit: Fit
    step: Step
    comparison: Comparison
    number: int | None = None

    @property
    def aside(self) -> frozenset[int]:
        """Rows of the readings that are set aside."""
        return frozenset(self.step.set_aside)


class State:
    """One window's work. Everything that changes it returns nothing and tells those who watch it.

    Attributes:
        path: of the measurement; None before one is open.
        measurement: with all its readings.
        models: on the way from the first one to the one in use.
        own: the user's own effects.
        diagnosis: of the model in use, with what follows from it; None before it was made.
        suggested: rows of readings that do not belong to the rest, as `mtcal identify` finds them.
        remark: what the page should say.
    """

    def __init__(self, own: Sequence[PhysicalEffect] = (), variant: str | None = None) -> None:
        self.path: Path | None = None
        self.measurement: Measurement | None = None
        self.models: list[Model] = []
        self.own = {effect.id: effect for effect in own}
        self.variant = variant
        self.diagnosis: tuple[Diagnosis, Conclusions] | None = None
        self.suggested: tuple[int, ...] = ()
        self.remark = ""
        self.history = History()
        self._watchers: list[Callable[[], None]] = []

    def watch(self, tell: Callable[[], None]) -> None:
        """Have something called whenever another model is in use, or another measurement."""
        self._watchers.append(tell)

    @property
    def session(self) -> Session:
        """The measurement's session, with all its readings.

        Raises:
            CalibrationError: none is open.
        """
        if self.measurement is None:
            raise CalibrationError("no measurement is open")
        return self.measurement.sessions[0]

    @property
    def model(self) -> Model:
        """The one in use.

        Raises:
            CalibrationError: none is open.
        """
        if not self.models:
            raise CalibrationError("no measurement is open")
        return self.models[-1]

    def opened(self, path: Path) -> Callable[[], None]:
        """Read a measurement and fit its models; may be done in a thread.

        Returns:
            What puts it in the place of the one that is open.
        """
        measurement = load(path)
        session = measurement.sessions[0]
        entry, history, remark = self._kept(path, session)
        suggested = Fit(measurement, identify(session, model=self.variant, own=self._own)).rejected["row"]
        chain = [] if entry is None else _ancestors(history, entry)
        models: list[Model] = []
        try:
            for one in chain:
                models.append(self._refitted(measurement, one, models))
        except CalibrationError as error:
            models, remark = [], f"the history's model {one.number} cannot be fitted ({error}): the first one is in use"
        if not models:
            models = [self._tried(measurement, None, "", (), frozenset())]

        def show() -> None:
            self.path, self.measurement, self.models = path, measurement, models
            self.suggested = tuple(int(row) for row in suggested)
            self.history, self.remark, self.diagnosis = history, remark, None
            self._tell()

        return show

    def changed(
        self,
        *,
        add: Iterable[str] = (),
        take: Iterable[str] = (),
        aside: Iterable[int] | None = None,
        over: Sequence[EffectSet] = (),
    ) -> Callable[[], None]:
        """Fit the model in use with a change; may be done in a thread.

        Args:
            add: ids of effects.
            take: ids of effects that it has.
            aside: rows of all readings that are to be set aside; those of the model in use if absent.
            over: sets of effects over which the map is to be averaged.

        Returns:
            What puts the changed model into use.
        """
        now = self.model
        rows = now.aside if aside is None else frozenset(aside)
        added, taken = list(add), set(take)
        effects = [*(name for name in now.fit.effects if name not in taken), *added]
        words = [*added, *(f"without {name}" for name in taken)]
        more, fewer = len(rows - now.aside), len(now.aside - rows)
        words += [
            f"{k} reading{'s' if k > 1 else ''} {what}" for k, what in ((more, "set aside"), (fewer, "put back")) if k
        ]
        assert self.measurement is not None
        model = self._tried(self.measurement, now, " + ".join(words), effects, rows, over)
        return lambda: self.use(model)

    def diagnosed(self, progress: Callable[[str, float], None]) -> Callable[[], None]:
        """Look for effects that the model in use lacks, and for what would tell them apart; may be done in a thread.

        Args:
            progress: called with what is being done and the share that is finished.

        Returns:
            What takes the diagnosis.
        """
        fit = self.model.fit
        found = diagnose(
            fit.measurement.sessions,
            model=self.variant,
            effects=fit.effects,
            own=self._own,
            progress=lambda what, share: progress(what, SEARCH * share),
        )
        then = conclude(found, model=self.variant, own=self._own, progress=progress)

        def take() -> None:
            self.diagnosis = found, then
            self._tell()

        return take

    def tried(self, effect: str) -> Model:
        """The model in use with one effect more, which is not put into use; may be done in a thread."""
        assert self.measurement is not None
        now = self.model
        return self._tried(self.measurement, now, effect, (*now.fit.effects, effect), now.aside)

    def used(self, number: int) -> Callable[[], None]:
        """Fit a model of the history and those that it was made from; may be done in a thread.

        Returns:
            What puts it into use.
        """
        assert self.measurement is not None
        models: list[Model] = []
        for entry in _ancestors(self.history, self.history.entry(number)):
            models.append(self._refitted(self.measurement, entry, models))

        def use() -> None:
            self.models, self.diagnosis = models, None
            self._keep(lambda old: old.using(number))
            self._tell()

        return use

    def improved(self) -> Callable[[], None]:
        """Set aside and add what the diagnosis of the model in use names, one by one, as `mtcal improve` does.

        Returns:
            What puts the models into use.

        Raises:
            CalibrationError: there is no diagnosis yet.
        """
        if self.diagnosis is None or self.measurement is None:
            raise CalibrationError("there is no diagnosis of this model yet: make one first")
        found, made = self.diagnosis[0], [self.model]
        start = self.model.fit.effects
        aside = self.model.aside | {outlier.row for outlier in found.outliers}
        if aside != self.model.aside:
            count = len(aside - self.model.aside)
            words = f"{count} reading{'s' if count > 1 else ''} set aside"
            made.append(self._tried(self.measurement, made[-1], words, start, aside))
        for k, name in enumerate(found.accepted):
            last = k + 1 == len(found.accepted)
            over = [EffectSet((*start, *one.effects), one.probability) for one in found.sets] if last else []
            effects = (*start, *found.accepted[: k + 1])
            made.append(self._tried(self.measurement, made[-1], name, effects, aside, over))

        return lambda: self.use(*made[1:])

    def undo(self) -> None:
        """Go back to the model that the one in use was made from."""
        if len(self.models) < 2:
            self.remark = "There is nothing to undo: this is the first model."
        else:
            self.models.pop()
            before = self.models[-1].number
            if before is not None:
                self._keep(lambda old: old.using(before))
        self.diagnosis = None
        self._tell()

    @property
    def _own(self) -> tuple[PhysicalEffect, ...]:
        return tuple(self.own.values())

    def _tell(self) -> None:
        for tell in self._watchers:
            tell()

    def use(self, *models: Model) -> None:
        """Put models, each made from the one before, into use, and keep them in the history."""
        self.models += models
        self.diagnosis = None
        prints, made = fingerprint(self.session), datetime.now(UTC).isoformat(timespec="seconds")
        entries = [entry_of(one.step, prints, made, "workbench") for one in self.models]
        self._keep(lambda old: old.grown(entries))
        kept = self.history.models
        self.models = [
            replace(one, number=next(old.number for old in kept if old.same_model(entry)))
            for one, entry in zip(self.models, entries, strict=True)
        ]
        self._tell()

    def _keep(self, change: Callable[[History], History]) -> None:
        """Change the history; where its file cannot be written this window's own."""
        assert self.path is not None
        try:
            self.history = update_history(history_path(self.path), change)
        except SessionError as error:
            self.history = change(self.history)
            self.remark = f"{error}; the models are kept in this window only"

    def _kept(self, path: Path, session: Session) -> tuple[Entry | None, History, str]:
        try:
            history = read_history(history_path(path))
        except SessionError as error:
            return None, History(), f"{error}; this window begins with the first model"
        entry, remark = history.in_use, ""
        if entry is not None and entry.data != fingerprint(session):
            remark = f"the readings have changed since model {entry.number} was made of them"
        return entry, history, remark

    def _tried(
        self,
        measurement: Measurement,
        before: Model | None,
        words: str,
        effects: Sequence[str],
        aside: frozenset[int],
        over: Sequence[EffectSet] = (),
    ) -> Model:
        session = measurement.sessions[0]
        left = np.isin(session.readings.row, sorted(aside))
        if left.any():
            measurement = replace(measurement, sessions=(session.with_readings(session.readings.select(~left)),))
        result = identify(
            measurement.sessions[0], model=self.variant, effects=effects, own=self._own, keep_all=True, sets=over
        )
        fit = Fit(measurement, result, self.variant, self._own, keep_all=True)
        step = step_after(before.step if before else None, words, result, tuple(sorted(aside)))
        return Model(fit, step, compare(result))

    def _refitted(self, measurement: Measurement, entry: Entry, before: Sequence[Model]) -> Model:
        model = self._tried(
            measurement,
            before[-1] if before else None,
            entry.change,
            entry.effects,
            frozenset(entry.set_aside),
            entry.sets(),
        )
        return replace(model, number=entry.number)


def _ancestors(history: History, entry: Entry | None) -> list[Entry]:
    """A model of a history after all those that it was made from, the first one first."""
    out: list[Entry] = []
    while entry is not None:
        out.append(entry)
        entry = None if entry.parent is None else history.entry(entry.parent)
    return out[::-1]
