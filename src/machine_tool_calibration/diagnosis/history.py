# SPDX-License-Identifier: Apache-2.0
"""The models of a measurement that were tried: which effects they hold, how well they fit, which one is current."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, model_validator

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.record import Finite, Record
from machine_tool_calibration.words import Verbatim, say, together

if TYPE_CHECKING:
    from machine_tool_calibration.effects.effect import Effect
    from machine_tool_calibration.methods.fitted import FitRequest
    from machine_tool_calibration.session.session import Session

# Difference of the criterion from which it speaks strongly for a model (Kass and Raftery 1995).
_CLEARLY = 6.0


Share = Annotated[float, Field(gt=0, lt=1)]
"""A probability."""


class Coefficient(Record):
    """A coefficient of an effect in a model."""

    name: str
    value: Finite
    standard_uncertainty: Finite
    unit: str


class Part(Record):
    """One of several sessions that were fitted together."""

    label: str  # name of the session
    model: str  # its method's variant
    data: str  # fingerprint of its readings
    set_aside: tuple[int, ...] = ()  # rows of its readings that were set aside
    kept: tuple[int, ...] = ()  # rows that were said to be sound, however far they stand out


class Entry(Record):
    """A model that was fitted."""

    number: Annotated[int, Field(ge=1)]  # from 1, in the order in which models were tried; never given twice
    parent: int | None = None  # number of the model that it was made from; None for a first one
    made: str  # date and time, ISO 8601
    by: str  # the command that made it
    model: str  # the method's variant; of several sessions `joint`, as each has its own
    sessions: tuple[Part, ...] = ()  # those that were fitted together; empty for one session
    effects: tuple[str, ...] = ()  # ids of the effects that were added to it
    own: tuple[dict[str, Any], ...] = ()  # definitions of those of them that are the user's own by formula
    # by effect, which others it may as well be, and by no name, which may be there beside all; with their probabilities
    alternatives: dict[str, dict[str, Share]] = Field(default_factory=dict)
    change: str = ""  # what it has and its parent has not, in a few words
    data: str  # fingerprint of the readings; another one means other readings
    used: Annotated[int, Field(ge=1)]  # number of readings in the fit
    set_aside: tuple[int, ...] = ()  # rows of readings that were set aside, of one session
    kept: tuple[int, ...] = ()  # rows that were said to be sound, however far they stand out, of one session
    rms_residual: Finite  # m
    reduced_chi_square: Finite | None = None  # weighted sum of squared residuals over the degrees of freedom
    degrees_of_freedom: int  # of the fit
    p_value: Finite | None = None  # probability of so large a sum of squares if model and declaration are right
    map_rms: Finite | None = None  # RMS length of the position errors of the map's points, m
    map_uncertainty_rms: Finite | None = None  # RMS length of their standard uncertainty, m
    map_change_rms: Finite | None = None  # RMS length by which they moved against the parent, m
    parameters: tuple[Coefficient, ...] = ()  # coefficients of the effects

    @model_validator(mode="after")
    def _check(self) -> Entry:
        for effect, others in self.alternatives.items():
            if effect not in ("", *self.effects) or others.keys() & {*self.effects}:
                raise ValueError(f"alternatives of {effect}: of an effect in the model others may be true that are not")
            if effect and sum(others.values()) > 1.0:
                raise ValueError(f"alternatives of {effect}: their probabilities sum to more than 1")
        return self

    def changed(self, parent: Entry | None) -> str:
        """What it has and its parent has not, for people: by keys where effects or readings say it."""
        if parent is None and (self.effects or not self.readings_aside):
            return self.change or say("step.first")
        before = parent or Entry.model_construct(number=0)
        added = [name for name in self.effects if name not in before.effects]
        aside = self.readings_aside - before.readings_aside
        told = [*added, *([say("step.set_aside", n=aside)] if aside > 0 else [])]
        if not told and self.alternatives.get("") and not before.alternatives.get(""):
            told = [say("step.may_be")]
        return together(told, ", ") if told else Verbatim(self.change)

    def request(
        self, sessions: Sequence[Session], labels: Sequence[str], prints: Sequence[str], own: Sequence[Effect] = ()
    ) -> FitRequest:
        """The model as it was fitted, of the readings that it was fitted to.

        What was set aside is left out of the sessions, which have all readings, fingerprints of them, and labels; what
        was put back is known to be sound, where they have it. The user's own effects at present take the place of the
        model's of the same name. A ModelError: a definition of an effect cannot be.
        """
        # here and below, because the file is read without the calculation that the results need
        import numpy as np

        from machine_tool_calibration.methods.fitted import FitRequest

        said = self._of_sessions(prints, labels)
        kept = []
        for session, one, own_data in zip(sessions, said, prints, strict=True):
            if one is not None:
                rows = session.readings.row.tolist()
                if one.data == own_data and (unknown := {*one.set_aside, *one.kept}.difference(rows)):
                    raise ModelError(f"model {self.number} of the history names row {min(unknown)}: there is none")
                session = session.keeping(set(one.kept).intersection(rows))
                aside = np.isin(rows, [row for row in one.set_aside if row not in session.sound])
                session = session.without(aside) if aside.any() else session
            kept.append(session)
        return FitRequest(
            tuple(kept),
            tuple(labels),
            self._variant(said, sessions),
            self.effects,
            tuple(self.own_effects(own)),
            keep_all=True,
            alternatives=self.alternatives,
        )

    def _of_sessions(self, prints: Sequence[str], labels: Sequence[str]) -> list[Entry | Part | None]:
        """What it says of each session: itself of a single one, of several the part of the same readings or name."""
        if len(prints) == 1:
            return [self]
        by_data = {part.data: part for part in self.sessions}
        by_label = {part.label: part for part in self.sessions}
        return [by_data.get(data, by_label.get(label)) for data, label in zip(prints, labels, strict=True)]

    def _variant(self, said: Sequence[Entry | Part | None], sessions: Sequence[Session]) -> str | None:
        """The variant to ask for, so that sessions are fitted as this model was; None for their defaults."""
        if len(sessions) == 1:
            return self.model
        # Of several, those that have the variant that was asked for took it, all others what they can share.
        for part, spec in zip(said, (spec_of(session) for session in sessions), strict=True):
            if part is not None and part.model != (spec.tables or next(iter(spec.models))):
                return part.model
        return None

    def own_effects(self, known: Sequence[Effect] = ()) -> list[Effect]:
        """Effects of the user's own: those known at present, and others that the model has by formula.

        A ModelError: a definition cannot be.
        """
        there = {effect.id for effect in known}
        kept = [definition for definition in self.own if definition.get("id") not in there]
        if not kept:
            return list(known)
        # here, because the file is read without the calculation that the effects need
        from machine_tool_calibration.effects.formula import FormulaEffect

        return [*known, *(FormulaEffect(one, f"model {self.number} of the history") for one in kept)]

    def same_model(self, other: Entry) -> bool:
        """Whether another entry is the same model of the same readings, with the same outcome."""
        alike = all(
            getattr(self, key) == getattr(other, key)
            for key in ("data", "model", "own", "alternatives", "set_aside", "kept")
        )
        alike &= all({*getattr(self, key)} == {*getattr(other, key)} for key in ("sessions", "effects"))
        return alike and math.isclose(self.rms_residual, other.rms_residual, rel_tol=1e-6)

    def criterion(self) -> float:
        """The Bayesian information criterion over the number of readings, but for what all models have in common."""
        squares = max((self.reduced_chi_square or math.inf) * self.degrees_of_freedom, 1e-300) / self.used
        return math.log(squares) + (1.0 - self.degrees_of_freedom / self.used) * math.log(self.used)

    @property
    def readings_aside(self) -> int:
        """How many readings were set aside, of all sessions."""
        return len(self.set_aside) + sum(len(part.set_aside) for part in self.sessions)


class History(Record):
    """All models that were tried; nothing is ever removed."""

    format: Literal["mtcal-history/1"] = "mtcal-history/1"
    current: int | None = None  # number of the model in use; None while there is none
    models: tuple[Entry, ...] = ()  # in the order in which they were tried

    @model_validator(mode="after")
    def _check(self) -> History:
        numbers = [entry.number for entry in self.models]
        if len(set(numbers)) < len(numbers):
            raise ValueError("two models have the same number")
        for entry in self.models:
            if entry.parent is not None and not (entry.parent in numbers and entry.parent < entry.number):
                raise ValueError(f"model {entry.number} comes from model {entry.parent}, which is not there before it")
        if self.current is not None and self.current not in numbers:
            raise ValueError(f"the current model {self.current} is not there")
        return self

    def entry(self, number: int) -> Entry:
        """The model of that number. A ModelError: there is none."""
        for entry in self.models:
            if entry.number == number:
                return entry
        known = ", ".join(str(entry.number) for entry in self.models) or "none yet"
        raise ModelError(f"the history has no model {number}; it has {known}")

    def way_to(self, number: int) -> tuple[Entry, ...]:
        """The models from a first one to that of a number, each made from the one before.

        A ModelError: there is none of that number.
        """
        way = [self.entry(number)]
        while way[0].parent is not None:
            way.insert(0, self.entry(way[0].parent))
        return tuple(way)

    @property
    def in_use(self) -> Entry | None:
        """The current model."""
        return None if self.current is None else self.entry(self.current)

    @property
    def better(self) -> Entry | None:
        """The model that describes the same readings, or more, clearly better than the one in use; None if none does.

        By the Bayesian information criterion, with the noise that each model leaves (Schwarz 1978).
        """
        now = self.in_use
        known = [one for one in self.models if now and one.data == now.data and one.used >= now.used]
        best = min(known, key=Entry.criterion, default=None)
        if now is None or best is None or best.criterion() > now.criterion() - _CLEARLY / now.used:
            return None
        return best

    def grown(self, entries: Sequence[Entry]) -> History:
        """With models made one from the other; the last is the current one.

        A model that is there already is not repeated. Numbers and parents of the entries given do not matter.
        """
        models = list(self.models)
        parent: int | None = None
        for entry in entries:
            old = next((known for known in models if known.same_model(entry)), None)
            if old is None:
                number = max((known.number for known in models), default=0) + 1
                old = entry.model_copy(update={"number": number, "parent": parent})
                models.append(old)
            parent = old.number
        return self.model_copy(update={"models": tuple(models), "current": parent if entries else self.current})

    def undone(self) -> History:
        """With that model in use which the current one was made from.

        A ModelError: the current model is a first one, or there is none.
        """
        now = self.in_use
        if now is None:
            raise ModelError("the history is empty: there is nothing to undo")
        if now.parent is None:
            raise ModelError(f"model {now.number} was made from no other: there is nothing to undo")
        return self.using(now.parent)

    def using(self, number: int) -> History:
        """With the model of that number in use. A ModelError: there is none."""
        return self.model_copy(update={"current": self.entry(number).number})
