# SPDX-License-Identifier: Apache-2.0
"""Whether a common mistake explains a measurement: what may have been mistaken, and the one way to decide.

What is measured is judged by a misfit: against the nominal geometry when a session is read, against a model when it is
fitted. Where it does not fit, the measurement is judged anew as it would be without each mistake in turn: in another
unit, of the other sense of rotation, with two setups exchanged. The first that explains it far better is named. Nothing
is refused merely because it fits badly: that is for the model and its diagnosis.

Readings that contradict the stated geometry by more than any machine and any survey can be off are refused. Each method
says what its geometry makes of places, beams and displacements, and how far these may be off (`MethodSpec.held`). What
is commanded contradicts by a single row; of what is read, only by more than gross errors do.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import ModelError, SessionError
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.description import Place
from machine_tool_calibration.session.judgements import Held, Judgement, Supposition
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import figures

LENGTHS = "like millimetres; lengths are in metres"
UNITS = ((1e-3, f"displacement looks {LENGTHS}"), (1e-6, f"displacement looks {LENGTHS.replace('milli', 'micro')}"))
SENSES = (
    (-1.0, "displacement has the opposite sign; it grows with the path from the instrument"),
    (0.5, "displacement looks like twice the change of path"),
)
_MOST_EXCHANGED = 8  # exchanges are tried among so many setups, targets or points
_SLIPPED = (1, -1, 2, -2)  # rows


def explanation(session: Session, judgements: Iterable[Judgement]) -> str | None:
    """The first mistake without which a measurement, and a model of it, fits that does not as it is; else None."""
    for judgement in judgements:
        now = judgement.misfit(session)
        if not now > judgement.absurd:
            continue
        enough = min(judgement.good, judgement.better * now)
        for supposition in judgement.suppositions:
            try:
                misfit = judgement.misfit(supposition.session)
            except (ModelError, np.linalg.LinAlgError):
                continue
            if misfit < enough:
                return supposition.what
    return None


_ROWS = 20_000  # enough to judge by


def check_consistency(session: Session, place: Place) -> None:
    """Refuse readings that a common mistake explains and the nominal geometry does not (SessionError names it)."""
    rows = np.flatnonzero(np.isfinite(session.readings.displacement))
    sample = session.with_readings(session.readings.select(rows[:: max(1, -(-len(rows) // _ROWS))]))
    if len(sample.readings) < 4:
        return
    with np.errstate(all="ignore"):
        what = explanation(sample, spec_of(session).nominal(sample, place))
    if what is not None:
        raise SessionError(f"{place.readings}: {what}")


def scaled(session: Session, *factors: tuple[float, str]) -> Iterator[Supposition]:
    """Displacements multiplied by a factor: in another unit (`UNITS`), or of another sense (`SENSES`)."""
    for factor, what in factors:
        yield with_columns(session, what, displacement=factor * session.readings.displacement)


def with_columns(session: Session, what: str, **columns: Array) -> Supposition:
    """Other values, each (n,), in columns, that of the displacement among them."""
    displacement = columns.pop("displacement", session.readings.displacement)
    readings = replace(session.readings, displacement=displacement, columns={**session.readings.columns, **columns})
    return Supposition(what, session.with_readings(readings))


def shifted(session: Session, name: str, values: Array) -> Iterator[Supposition]:
    """Values (n,) of a column, or `displacement`, that slipped by some rows against the others."""
    for rows in _SLIPPED:
        which = f"{abs(rows)} row{'s' if abs(rows) > 1 else ''} {'down' if rows > 0 else 'up'}"
        yield with_columns(session, f"{name} looks shifted by {which}", **{name: np.roll(values, -rows)})


def in_degrees(session: Session, what: str, *names: str) -> Supposition:
    """Angles in degrees, in those of the columns that there are."""
    known = {name: np.radians(session.readings.columns[name]) for name in names if name in session.readings.columns}
    return with_columns(session, f"{what} like degrees; angles are in radians", **known)


def exchanged_axes(session: Session, dimension: int) -> Iterator[Supposition]:
    """Two of the columns x, y and z exchanged."""
    return exchanged_columns(session, dict(zip("xyz"[:dimension], session.readings.position().T, strict=False)))


def exchanged_columns(session: Session, values: Mapping[str, Array]) -> Iterator[Supposition]:
    """Two of some columns, by name each (n,), exchanged."""
    for one, other in itertools.combinations(values, 2):
        what = f"the columns {one} and {other} look exchanged"
        yield with_columns(session, what, **{one: values[other], other: values[one]})


def exchanged(session: Session, kind: str, among: Sequence[str], setup: str | None = None) -> Iterator[Supposition]:
    """Two setups exchanged, or two names in the column `kind`; among the first few of the names that may be.

    In all readings, or in those of a setup alone.
    """
    readings = session.readings
    mine = np.ones(len(readings), dtype=bool) if setup is None else readings.setup == session.setup_ids.index(setup)
    labels = readings.setup if kind == "setup" else readings.labels[kind]
    for pair in itertools.combinations(among[:_MOST_EXCHANGED], 2):
        one, other = map(session.setup_ids.index, pair) if kind == "setup" else pair
        new = np.where(mine & (labels == one), other, np.where(mine & (labels == other), one, labels))
        changed: dict[str, Any] = {"setup": new} if kind == "setup" else {"labels": {**readings.labels, kind: new}}
        what = f"the {kind}s {pair[0]!r} and {pair[1]!r} look exchanged{f' in setup {setup!r}' if setup else ''}"
        yield Supposition(what, session.with_readings(replace(readings, **changed)))


def described(session: Session, what: str, **update: object) -> Supposition:
    """Other keys in the description."""
    return Supposition(what, replace(session, description=session.description.model_copy(update=update)))


def turned_round(session: Session, what: str) -> Supposition:
    """A rotary axis that turns the other way."""
    sign = {"rotation_sign": -session.rotation_sign}
    own = sign if hasattr(session.description, "rotation_sign") else {}
    return described(session, what, machine=session.description.machine.model_copy(update=sign), **own)


_FEWEST = 3  # readings: fewer are single whatever their share
# Share of a setup's readings that may be left, and of those that contradict, where a mistake explains them: the ends.
_LEFT, _CONTRADICTING_LEFT = 0.06, 0.2
# What a column may have been multiplied by.
_TIMES = ((-1.0, "of the opposite sign"), (2.0, "doubled"), (0.5, "halved"))


Expected = Callable[[Session], Iterable[Held]]
"""Of a session, what in it is held against what."""


@np.errstate(all="ignore")
def refuse_contradictions(session: Session, place: Place, expected: Expected | None = None) -> None:
    """Refuse readings (all are there) that contradict what the session states, or what else is `expected`.

    A SessionError names setup, worst row, by how much it is off what, how many others are, and what is likelier meant.
    """
    held_of = expected or spec_of(session).held
    every = list(held_of(session))
    if sum(int(held.bad.sum()) for held in every) < _FEWEST and not any(_contradicted(session, h) for h in every):
        return

    def misfit(other: Session) -> float:
        return float(np.mean(np.any([held.bad for held in held_of(other)], axis=0)))

    some = session.with_readings(session.readings.select(np.arange(min(len(session.readings), _ROWS))))
    slip = explanation(some, [Judgement(misfit, _slips(some), 0.0, _LEFT, _CONTRADICTING_LEFT)])
    # Few that contradict are gross errors, unless all of them come from one slip.
    for held in every:
        if _contradicted(session, held) or (slip and held.bad.any()):
            raise SessionError(_words(session, place, held, slip or ""))


def _contradicted(session: Session, held: Held) -> bool:
    _, share, bad = _shares(session, held)
    return bool(((share > held.share) & ((bad >= _FEWEST) | (held.share == 0.0))).any())


def _shares(session: Session, held: Held) -> tuple[IntArray, Array, Array]:
    """(n,) group of each reading, and of each group the share of readings that contradict, and how many they are."""
    group = session.readings.setup if held.group is None else held.group
    every = np.bincount(group)
    bad = np.bincount(group, held.bad, minlength=len(every))
    return group, bad / np.maximum(every, 1), np.asarray(bad, dtype=float)


def _words(session: Session, place: Place, held: Held, likelier: str) -> str:
    """What contradicts what, in the group where the most do, the worst first, and what is likelier meant."""
    read = session.readings
    group, share, _ = _shares(session, held)
    mine = group == np.argmax(share)
    rows = np.flatnonzero(held.bad & mine)
    rows = rows[np.argsort(-held.off[rows], kind="stable")]
    count, setup = int(mine.sum()), int(read.setup[rows[0]])
    by = f"contradicts {held.against}"
    if held.unit:
        by = f"is {_size(float(held.off[rows[0]]), held.unit)} off {held.against}"
    likelier = likelier or held.hint(setup)
    owner = f"setup {session.setup_ids[setup]!r}"
    if held.label:
        owner = f"{held.label} {str(read.labels[held.label][rows[0]])!r}"
    several = f"one of {len(rows)} of its {count} readings that do"
    which = several if len(rows) > 1 else f"the only one of its {count} readings that does"
    return f"{place.row(read.row[rows[0]])}: {held.what} of {owner} {by}, {which}{f': {likelier}' if likelier else ''}"


def _slips(session: Session) -> Iterator[Supposition]:
    readings = session.readings
    values = {n: readings.columns[n] for n in (*"xyzabc", "azimuth", "elevation") if n in readings.columns}
    values["displacement"] = readings.displacement
    for name, value in values.items():
        yield from shifted(session, name, value)
        for factor, what in _TIMES:
            yield with_columns(session, f"{name} looks {what}", **{name: value / factor})
    yield from exchanged_columns(session, values)


def _size(value: float, unit: str) -> str:
    return f"{figures(value)} rad" if unit == "rad" else f"{figures(1e3 * value, 4)} mm"
