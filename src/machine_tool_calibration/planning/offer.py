# SPDX-License-Identifier: Apache-2.0
"""All that a procedure could measure in one session, of which a plan is a part."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.procedure.description import Choices, Procedure, expanded, parse_procedure
from machine_tool_calibration.procedure.steps import plan
from machine_tool_calibration.session.description import Probing, RotaryAxis
from machine_tool_calibration.session.text import load_yaml, yaml_text

_MOST_CANDIDATES = 1000  # setups, or targets, that are held against each other: more would take hours


@dataclass(frozen=True)
class Choice:
    """A plan: which setups and which targets, and how often."""

    setups: tuple[int, ...]  # numbers of the offer's setups, in the order in which they are measured
    targets: tuple[int, ...]  # numbers of its targets (or features); of a method without any the only one
    repeats: int  # of each setup


@dataclass(frozen=True)
class Offer:
    """What could be measured."""

    # the procedure's file with every candidate setup and target, measured once, or once in either sense of the path
    content: Mapping[str, Any]
    procedure: Procedure  # the same as a procedure
    choices: Choices  # what is allowed
    targets: tuple[str, ...]  # names of the targets, or a workpiece's features; one without a name if there are none
    always: tuple[int, ...]  # numbers of the targets that every plan has
    present: Choice  # the plan of the procedure as it stands

    @property
    def setups(self) -> tuple[str, ...]:
        """Ids of all setups."""
        return tuple(entry.id for entry in self.procedure.session.setups)

    @cached_property
    def unit_seconds(self) -> Array:
        """(S, T) time of moving and waiting for each target from each setup, s."""
        made = plan(self.procedure)
        spent = np.zeros((len(self.setups), len(self.targets)))
        place = {name: k for k, name in enumerate(self.setups)}
        for step, seconds in zip(made.steps, np.diff(made.ends, prepend=0.0), strict=True):
            spent[place[step.setup], self._target_of(step.target)] += seconds / self._senses
        return spent

    @property
    def _senses(self) -> int:
        """Of the path that are candidates of their own: 1, or 2 where every second repeat goes back."""
        return int(self.procedure.session.repeats)

    def in_each_sense(self, repeats: int) -> IntArray:
        """How many of so many repeats go in each sense of the path."""
        return np.array([(repeats + k) // self._senses for k in reversed(range(self._senses))])

    def _target_of(self, number: int | None) -> int:
        session = self.procedure.session
        if isinstance(session, Probing):
            return self.targets.index(session.workpiece[number or 0].feature)
        return (number or 0) if isinstance(session, RotaryAxis) else 0

    def unit_of(self, observed: Observations) -> IntArray:
        """(n,) which candidate each reading belongs to: by setup, target and sense of the path."""
        readings, session = observed.readings, self.procedure.session
        if isinstance(session, Probing):
            feature = {point.id: self.targets.index(point.feature) for point in session.workpiece}
            target = np.array([feature[str(name)] for name in readings.labels["point"]])
        elif isinstance(session, RotaryAxis):
            target = np.array([self.targets.index(str(name)) for name in readings.labels["target"]])
        else:
            target = np.zeros(len(readings), dtype=np.int64)
        return np.asarray((readings.setup * len(self.targets) + target) * self._senses + readings.repeat)

    def weights(self, choice: Choice) -> Array:
        """(S T senses,) how often each candidate is measured."""
        out = np.zeros((len(self.setups), len(self.targets), self._senses))
        out[np.ix_(choice.setups, choice.targets)] = self.in_each_sense(choice.repeats)
        return out.reshape(-1)

    @cached_property
    def seconds(self) -> float:
        """Time that is allowed, s."""
        return self.choices.seconds or self.duration(self.present)

    def duration(self, choice: Choice) -> float:
        """Time of a plan with mounting, s."""
        return plan(self.procedure_of(choice)).duration + self.choices.mounting * len(choice.setups)

    def rough_duration(self, choice: Choice) -> float:
        """The same as the sum over its parts, each as it takes among all others."""
        inner = self.unit_seconds[np.ix_(choice.setups, choice.targets)].sum()
        return float(choice.repeats * inner + self.choices.mounting * len(choice.setups))

    def procedure_of(self, choice: Choice) -> Procedure:
        """A plan as a procedure."""
        return parse_procedure(self.text(choice), self.procedure.source)

    def text(self, choice: Choice) -> str:
        """The file of a plan's procedure; comments are lost."""
        content, session = dict(self.content), dict(self.content["session"])
        session["setups"] = [session["setups"][k] for k in choice.setups]
        session["repeats"] = choice.repeats
        kept = {self.targets[k] for k in choice.targets}
        if "targets" in session:
            session["targets"] = [entry for entry in session["targets"] if entry["id"] in kept]
        if "workpiece" in session:
            session["workpiece"] = [entry for entry in session["workpiece"] if entry.get("feature", "work") in kept]
        content["session"] = session
        return yaml_text(content)


def offer(text: str, source: str, *, both_senses: bool = False) -> Offer:
    """What the text of a procedure's file offers.

    With `both_senses` repeats that run the path backwards are candidates of their own: they tell something else. A
    SessionError as for `parse_procedure`, or a candidate that is none.
    """
    present = parse_procedure(text, source)
    choices = present.choices
    content = dict(load_yaml(text, source).value)
    content.pop("choices", None)
    session: dict[str, Any] = dict(content["session"])
    own_setups = len(session["setups"])
    session["setups"] = _with_candidates(session["setups"], choices.setups, f"{source}: choices.setups", "S")
    own_targets = len(session.get("targets", ()))
    if choices.targets:
        if own_targets == 0:
            raise SessionError(f"{source}: choices.targets are for a session with targets")
        session["targets"] = _with_candidates(session["targets"], choices.targets, f"{source}: choices.targets", "T")
    repeats = session.get("repeats", 1)
    returns = both_senses and present.path.alternate and max((repeats, *choices.repeats)) > 1
    session["repeats"] = 2 if returns else 1
    content["session"] = session
    whole = parse_procedure(yaml_text(content), source)
    targets, always = _targets(whole, choices, source)
    first = range(own_targets) if own_targets else range(len(targets))
    now = Choice(tuple(range(own_setups)), tuple(first), repeats)
    return Offer(content, whole, choices, targets, always, now)


def _targets(whole: Procedure, choices: Choices, source: str) -> tuple[tuple[str, ...], tuple[int, ...]]:
    session = whole.session
    if isinstance(session, RotaryAxis):
        return tuple(target.id for target in session.targets), ()
    if not isinstance(session, Probing):
        if choices.features:
            raise SessionError(
                f"{source}: choices.features are for a workpiece, and a {session.method} session has none"
            )
        return ("",), (0,)
    features = tuple(dict.fromkeys(point.feature for point in session.workpiece))
    for name in choices.features:
        if name not in features:
            raise SessionError(f"{source}: choices.features names {name!r}; the workpiece has {', '.join(features)}")
    return features, tuple(k for k, name in enumerate(features) if name not in choices.features)


def _with_candidates(
    own: Sequence[Mapping[str, Any]], templates: Sequence[Mapping[str, Any]], where: str, letter: str
) -> list[dict[str, Any]]:
    """The entries of a file followed by those that templates stand for; those that are there already only once."""
    entries = [dict(entry) for entry in own]
    nameless = [{key: value for key, value in entry.items() if key != "id"} for entry in entries]
    taken = {str(entry.get("id")) for entry in entries}
    for number, template in enumerate(templates):
        for entry in expanded(template):
            # an id of its own may say more, such as the order of a step diagonal's moves
            if entry in entries or entry in nameless:
                continue
            nameless.append({key: value for key, value in entry.items() if key != "id"})
            free = (name for k in itertools.count(1) if (name := f"{letter}{k}") not in taken)
            name = str(entry.pop("id", None) or next(free))
            if name in taken:
                raise SessionError(f"{where}[{number}]: the id {name!r} is taken; without one they are numbered")
            taken.add(name)
            entries.append({"id": name, **entry})
            if len(entries) > _MOST_CANDIDATES:
                raise SessionError(f"{where}: more than {_MOST_CANDIDATES} candidates; a coarser grid tells as much")
    return entries
