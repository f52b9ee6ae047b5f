# SPDX-License-Identifier: Apache-2.0
"""What one window works on: the measurement, the models that were tried on the way, and the one in use."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Self

from machine_tool_calibration.diagnosis.history import Entry, History
from machine_tool_calibration.diagnosis.improve import entry_of
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.interface.diagnosis import Diagnosis
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.recording.open import is_session_folder
from machine_tool_calibration.reports.history import fingerprint, history_path, update_history
from machine_tool_calibration.reports.quantities import rounded
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say
from machine_tool_calibration.workbench.models import Model, Opened, Subject, diagnosed, improved, opened


def measurements_in(folder: Path) -> list[Path]:
    """Sessions and recordings that lie in a folder, itself first if it is one."""
    from machine_tool_calibration.recording.reader import is_bag

    def holds(path: Path) -> bool:
        return is_session_folder(path) or is_bag(path)

    if folder.is_file() or holds(folder):
        return [folder]
    return sorted(path for path in folder.iterdir() if holds(path)) if folder.is_dir() else []


@dataclass(frozen=True)
class Job:
    """Something to be calculated, perhaps in another process, and what takes the outcome."""

    # the calculation, given what it reports its progress to. It knows nothing of the page
    work: Callable[[Progress], Any]
    take: Callable[[Any], None]  # shows the outcome

    def then(self, act: Callable[[], object]) -> Self:
        """The same, with something done after the outcome has been shown."""

        def take(found: Any) -> None:
            self.take(found)
            act()

        return replace(self, take=take)

    def __call__(self) -> None:
        """Do it here and now."""
        self.take(self.work(untold))


class State:
    """One window's work. Everything that changes it tells the one who watches it."""

    def __init__(self, own: Sequence[Effect] = (), variant: str | None = None) -> None:
        self.paths: tuple[Path, ...] = ()  # of the measurement; several are of one machine
        self.models: list[Model] = []  # on the way from the first one to the one in use
        self.furthest: Model | None = None  # the last of them before any was undone
        self.variant = variant
        self.diagnosis: Diagnosis | None = None  # of the model in use, with what follows from it
        self.remark = ""  # what the page should say
        self.history = History()
        self._kept = True
        self._given = tuple(own)
        self._subject: Subject | None = None
        self._prints: tuple[str, ...] = ()
        # called whenever another model is in use, or another measurement
        self.tell: Callable[[], None] = lambda: None

    @property
    def subject(self) -> Subject:
        """The measurement with all its readings, and the user's own effects; a CalibrationError if none is open."""
        if self._subject is None:
            raise CalibrationError("no measurement is open")
        return self._subject

    @property
    def sessions(self) -> tuple[Session, ...]:
        """The sessions, with all their readings."""
        return self.subject.measurement.sessions

    @property
    def model(self) -> Model:
        """The one in use; a CalibrationError if none is open."""
        if not self.models:
            raise CalibrationError("no measurement is open")
        return self.models[-1]

    @property
    def headline(self) -> str:
        """The model in use, and whether it is saved."""
        model = self.model
        words = [model.fit.headline]
        words += [say("step.set_aside", n=len(model.aside))] if model.aside else []
        words += [f"kept: {', '.join(map(self.subject.name, sorted(model.kept)))}"] if model.kept else []
        if model.number is None:
            words.append("not saved, as nothing was changed yet")
        else:
            words.append(f"{'saved as' if self._kept else 'not saved:'} model {model.number} of the history")
        return "; ".join(words)

    @property
    def warning(self) -> str:
        """That the history has a model that fits better; empty if it has none."""
        if (better := self.history.better) is None:
            return ""
        return (
            f"Model {better.number} ({better.change or 'first model'}) fits better, with a reduced chi-square of "
            f"{rounded(better.reduced_chi_square)}: Improve goes to it."
        )

    @property
    def lacking(self) -> bool:
        """Whether the diagnosis names what the model in use has not, or readings that it has not set aside."""
        found, model = self.diagnosis, self.model
        if found is None:
            return False
        return bool(found.accepted) or self.subject.deviations(found.set_aside).keys() != model.aside - model.by_user

    @property
    def own(self) -> dict[str, Effect]:
        """The user's own effects, by id."""
        return {effect.id: effect for effect in (self._given if self._subject is None else self._subject.own)}

    def know(self, effect: Effect) -> None:
        """Take up an effect of the user's own, in the place of one of that name."""
        self._subject = replace(self.subject, own=tuple((self.own | {effect.id: effect}).values()))

    def opened(self, *paths: Path) -> Job:
        """Read a measurement, or several of one machine, and fit its models."""

        def take(found: Opened) -> None:
            self.paths, self._subject, self._prints = paths, found.subject, found.prints
            self.models = found.models
            self.history, self.remark, self.diagnosis = found.history, found.remark, None
            self._tell()

        return Job(partial(opened, paths, self.variant, self._given), take)

    def changed(
        self, *, add: str = "", take: str = "", aside: Iterable[int] | None = None, variant: str | None = None
    ) -> Job:
        """Fit the model in use with a change: an effect added or taken by its id, another variant, other readings.

        `aside` are numbers of all readings that are to be set aside; variant and these are those of the model in use if
        absent. What a search had set aside and is put back is kept: no search sets it aside again.
        """
        now = self.model
        rows = now.aside if aside is None else frozenset(aside)
        effects = tuple(filter(None, (*(name for name in now.fit.effects if name != take), add)))
        back = now.aside - rows
        words = list(filter(None, (variant and f"model {variant}", add, take and f"without {take}")))
        for k, what in ((len(rows - now.aside), "set aside"), (len(back), "put back")):
            words += [f"{k} reading{'s' if k > 1 else ''} {what}"] if k else []
        kept = (now.kept | (back & now.found.keys())) - rows
        chosen = replace(now.fit.chosen, effects=effects, model=variant or now.fit.chosen.model)
        asked = (now, " + ".join(words), chosen)
        if effects == now.fit.effects and variant is None:
            return Job(partial(_quiet, self.subject.tried, *asked, rows, kept, now.found), self.use)
        return Job(partial(_quiet, self.subject.anew, *asked, rows - now.found.keys(), kept), self.use)

    def diagnosed(self) -> Job:
        """Look for effects that the model in use lacks, and for what would tell them apart."""

        def take(found: Diagnosis) -> None:
            self.diagnosis = found
            away = {**self.model.found, **self.subject.deviations(found.set_aside)}
            self.models[-1] = replace(self.model, found=away)
            self._tell()

        return Job(partial(diagnosed, self.subject, self.model), take)

    def tried(self, effect: str, show: Callable[[Model], None]) -> Job:
        """The model in use with one effect more, which is shown and not put into use."""
        now = self.model
        asked = (effect, now.fit.chosen.adding([effect]), now.by_user, now.kept)
        return Job(partial(_quiet, self.subject.anew, now, *asked), show)

    def used(self, number: int) -> Job:
        """Fit a model of the history and those that it was made from, and put it into use."""

        def use(models: list[Model]) -> None:
            self._keep(lambda old: old.using(number))
            self.models, self.diagnosis = models, None
            self._tell()

        way = self.history.way_to(number)
        return Job(partial(_quiet, self.subject.on_the_way, way, self._prints, self.models[0].found), use)

    def improved(self) -> Job:
        """Set aside and add what the diagnosis of the model in use names, one by one, as `mtcal improve` does."""
        if self.diagnosis is None:
            raise CalibrationError("there is no diagnosis of this model yet: make one first")
        return Job(partial(improved, self.subject, self.model, self.diagnosis), lambda models: self.use(*models))

    def undo(self) -> None:
        """Go back to the model that the one in use was made from."""
        if len(self.models) < 2:
            self.remark = "There is nothing to undo: this is the first model."
        else:
            self.models.pop()
            if self.models[-1].number is not None:
                self._keep_models()
        self.diagnosis = None
        self._tell(self.furthest)

    def use(self, *models: Model) -> None:
        """Put models, each made from the one before, into use, and keep them in the history."""
        self.models += models
        self.diagnosis = None
        self._keep_models()
        self._tell()

    def _keep_models(self) -> None:
        """Have them in the history, which may have been moved away, with their numbers there, and the last in use."""
        entries = self.entries()
        self._keep(lambda old: old.grown(entries))
        self.models = [
            replace(one, number=next(old.number for old in self.history.models if old.same_model(entry)))
            for one, entry in zip(self.models, entries, strict=True)
        ]

    def entries(self) -> list[Entry]:
        """The models as entries of a history."""
        now, data = datetime.now(UTC).isoformat(timespec="seconds"), fingerprint(*self.sessions)
        return [
            entry_of(one.step, data, self._prints, now, "workbench", number=one.number or k)
            for k, one in enumerate(self.models, 1)
        ]

    def _tell(self, furthest: Model | None = None) -> None:
        self.furthest = furthest or self.models[-1]
        self.tell()

    def _keep(self, change: Callable[[History], History]) -> None:
        """Change the history; where its file cannot be written this window's own."""
        self._kept = True
        try:
            _, self.history = update_history(history_path(*self.paths), change)
        except SessionError as error:
            self.history = change(self.history)
            self._kept = False
            self.remark = f"{error}; the models are kept in this window only"


def _quiet(calculate: Callable[..., Any], *args: Any) -> Any:
    """Calculate what reports no progress; that comes last in what is given."""
    return calculate(*args[:-1])
