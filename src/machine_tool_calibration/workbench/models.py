# SPDX-License-Identifier: Apache-2.0
"""Models of a measurement, and all that is calculated of them: none of it knows the page or its state.

What is here goes from process to process, so that the page can calculate in another one and end it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from machine_tool_calibration.arrays import IntArray
from machine_tool_calibration.budget import complete
from machine_tool_calibration.diagnosis.compare import Comparison, JointComparison, compare
from machine_tool_calibration.diagnosis.history import Entry, History
from machine_tool_calibration.diagnosis.improve import Step, accepted_models
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.interface.diagnosis import Diagnosis
from machine_tool_calibration.interface.identification import Fit
from machine_tool_calibration.interface.session import Measurement, load
from machine_tool_calibration.interface.show import printed
from machine_tool_calibration.methods.fitted import FitRequest, gross_errors
from machine_tool_calibration.planning.forecast import Assumed, forecast
from machine_tool_calibration.planning.outlook import Outlook, current, outlook_of
from machine_tool_calibration.procedure import Procedure
from machine_tool_calibration.progress import Progress
from machine_tool_calibration.reports.history import fingerprint, history_path, read_history
from machine_tool_calibration.reports.planning import forecast_parts
from machine_tool_calibration.residuals.gross_errors import Outlier
from machine_tool_calibration.words import say

Numbers = frozenset[int]
"""Numbers of readings, as `Subject` has them."""
Deviations = Mapping[int, float | None]
"""What readings deviate by from what all others predict, m, by number; None where they tell nothing of it."""


@dataclass(frozen=True)
class Model:
    """A model that was tried."""

    fit: Fit  # to the readings that are not set aside
    step: Step  # what it is on the way
    comparison: Comparison | JointComparison  # it, held against its readings
    aside: Numbers = frozenset()  # readings that are set aside
    kept: Numbers = frozenset()  # readings that are not to be set aside, however far they stand out
    number: int | None = None  # in the history; None while it is not kept
    # readings that a search found not to belong to the rest; the user set aside what is not among them
    found: Deviations = field(default_factory=dict)

    @property
    def each(self) -> tuple[Comparison, ...]:
        """The comparisons of the sessions."""
        return self.comparison.sessions

    @property
    def by_user(self) -> Numbers:
        """Numbers of the readings that the user set aside."""
        return self.aside - self.found.keys()


@dataclass(frozen=True)
class Subject:
    """A measurement with all its readings, and the user's own effects.

    Readings have a number: the row of the recording, counted on from session to session where there are several.
    """

    measurement: Measurement  # one session or several
    own: tuple[Effect, ...] = ()  # effects beside the catalogue

    @cached_property
    def first(self) -> tuple[int, ...]:
        """The number of each session's first reading."""
        counts = [len(session.readings) for session in self.measurement.sessions]
        return tuple(sum(counts[:k]) for k in range(len(counts)))

    def numbers(self, session: int, rows: IntArray) -> IntArray:
        """Numbers of rows of a session's recording."""
        return np.asarray(rows + self.first[session])

    def deviations(self, outliers: Iterable[Iterable[Outlier]]) -> Deviations:
        """Of the readings of each session that stand out."""
        every = zip(self.first, outliers, strict=True)
        return {first + outlier.row: outlier.deviation for first, own in every for outlier in own}

    def name(self, number: int) -> str:
        """Of a reading: its row, of several sessions with the session's name, as `--keep` takes it."""
        k = int(np.searchsorted(self.first, number, side="right")) - 1
        row = str(number - self.first[k])
        return row if len(self.first) == 1 else f"{self.measurement.labels[k]}:{row}"

    def without(self, aside: Iterable[int], kept: Iterable[int] = ()) -> Measurement:
        """The measurement without some readings, others being known to be sound."""
        sessions = []
        for k, session in enumerate(self.measurement.sessions):
            mine = self.numbers(k, session.readings.row)
            sound = session.keeping(session.readings.row[np.isin(mine, sorted(kept))].tolist())
            gone = np.isin(mine, sorted(aside))
            sessions.append(sound.without(gone) if gone.any() else sound)
        return replace(self.measurement, sessions=tuple(sessions))

    def chosen(self, model: Model) -> FitRequest:
        """The readings and the model, with the effects of the user's own that are known by now."""
        return replace(model.fit.chosen, own=self.own)

    def judged(self, chosen: FitRequest, aside: Iterable[int], kept: Iterable[int]) -> Deviations:
        """What `mtcal identify` would set aside beside a model: see `Model.found`."""
        chosen = replace(chosen, sessions=self.without(aside, kept).sessions, own=self.own)
        return self.deviations(own.outliers for own in gross_errors(chosen))

    def anew(self, before: Model, words: str, chosen: FitRequest, by_user: Numbers, kept: Numbers) -> Model:
        """A model with other effects, beside which other readings may belong to the rest; arguments as of `tried`."""
        found = self.judged(chosen, by_user, kept)
        return self.tried(before, words, chosen, by_user | found.keys(), kept, found)

    def tried(
        self, before: Model | None, words: str, chosen: FitRequest, aside: Numbers, kept: Numbers, found: Deviations
    ) -> Model:
        """A model, fitted: it has in `words` what the one before has not; a ModelError if the data does not allow it.

        Whatever readings `chosen` was fitted to, the numbers of those `aside` are left out, and those `kept` are sound.
        """
        measurement = self.without(aside, kept)
        chosen = replace(chosen, sessions=measurement.sessions, own=self.own, keep_all=True)
        result = complete.identify(chosen)
        rows = tuple(self._rows(k, aside) for k in range(len(self.first)))
        step = Step(before.step if before else None, words, chosen, result, rows)
        return Model(Fit(measurement, result, chosen), step, compare(result), aside, kept, found=found)

    def on_the_way(self, entries: Sequence[Entry], prints: Sequence[str], found: Deviations) -> list[Model]:
        """Models of a history, each made from the one before; `prints` are fingerprints of the sessions.

        `found` (see `Model.found`) is that beside the first model. What one with effects has not set aside belongs to
        the rest beside these.
        """
        models: list[Model] = []
        for entry in entries:
            chosen = entry.request(self.measurement.sessions, self.measurement.labels, prints, self.own)
            aside, kept = set[int](), set[int]()
            for k, (whole, fitted) in enumerate(zip(self.measurement.sessions, chosen.sessions, strict=True)):
                aside.update(self.numbers(k, np.setdiff1d(whole.readings.row, fitted.readings.row)).tolist())
                kept.update(self.numbers(k, np.array(sorted(fitted.sound), dtype=np.int64)).tolist())
            before = models[-1] if models else None
            own = {k: away for k, away in found.items() if k in aside or not chosen.effects}
            made = self.tried(before, entry.change, chosen, frozenset(aside), frozenset(kept), own)
            models.append(replace(made, number=entry.number))
        return models

    def _rows(self, session: int, numbers: Iterable[int]) -> tuple[int, ...]:
        first, count = self.first[session], len(self.measurement.sessions[session].readings)
        return tuple(sorted(number - first for number in numbers if 0 <= number - first < count))


@dataclass(frozen=True)
class Opened:
    """A measurement that was read."""

    subject: Subject  # it
    prints: tuple[str, ...]  # fingerprints of the sessions
    models: list[Model]  # on the way to the one in use
    history: History  # of models
    remark: str  # what is to be said


def opened(paths: Sequence[Path], variant: str | None, own: Sequence[Effect], progress: Progress) -> Opened:
    """Read a measurement and fit its models: those of the history, or the first one.

    Readings that do not belong to the rest are set aside in a second model, as `mtcal identify` does.
    """
    progress("reading", 0.0)
    measurement = load(*paths)
    sessions = measurement.sessions
    prints = tuple(fingerprint(session) for session in sessions)
    history, remark = History(), ""
    try:
        history = read_history(history_path(*paths))
    except SessionError as error:
        remark = f"{error}; this window begins with the first model"
    entry = history.in_use
    known = list(own)
    for one in history.models:
        known = one.own_effects(known)
    subject = Subject(measurement, tuple(known))
    if entry is not None and entry.data != fingerprint(*sessions):
        remark = f"the readings have changed since model {entry.number} was made of them"
    progress("readings that do not belong to the rest", 0.2)
    first = FitRequest(sessions, measurement.labels, variant, (), tuple(own))
    found = subject.judged(first, (), ())
    progress("fitting", 0.5)
    models: list[Model] = []
    if entry is not None:
        try:
            models = subject.on_the_way(history.way_to(entry.number), prints, found)
        except CalibrationError as error:
            remark = f"the history's model {entry.number} cannot be fitted ({error}): the first one is in use"
    if not models:
        none = Numbers()
        models.append(subject.tried(None, "", first, none, none, found))
        if found:
            words = say("step.set_aside", n=len(found))
            models.append(subject.tried(models[0], words, first, frozenset(found), none, found))
    return Opened(subject, prints, models, history, remark)


def diagnosed(subject: Subject, model: Model, progress: Progress) -> Diagnosis:
    """Effects that a model lacks, and what would tell them apart; what a search had set aside is judged anew."""
    sessions = subject.without(model.by_user, model.kept).sessions
    found, then = complete.diagnose(replace(subject.chosen(model), sessions=sessions), progress=progress)
    return Diagnosis.of(found, concluded=then)


def improved(subject: Subject, model: Model, found: Diagnosis, progress: Progress) -> list[Model]:
    """Set aside and add what a diagnosis names, as `mtcal improve` does: models, each made from the one before."""
    away = subject.deviations(found.set_aside)
    aside = model.by_user | away.keys()
    models = [model]
    for change, chosen in accepted_models(found, progress):
        if (aside, chosen.model_of) != (models[-1].aside, models[-1].fit.chosen.model_of):
            models.append(subject.tried(models[-1], change, chosen, aside, model.kept, away))
    return models[1:]


def planned(
    subject: Subject, model: Model | None, procedure: Procedure, assumed: Assumed, progress: Progress
) -> tuple[Outlook | None, Outlook, str]:
    """What a procedure would tell by itself, and that in the words of `mtcal plan`; first what a model tells now."""
    found = forecast(procedure, assumed, progress)
    now = None if model is None else current(subject.measurement.sessions[0], model.fit.result.error_map)
    return now, outlook_of(found, f"procedure {procedure.name}, by itself"), printed(forecast_parts(found))
