# SPDX-License-Identifier: Apache-2.0
"""Further measurements that could be made: run backwards, wait for another temperature, mount again, go elsewhere."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, groups, in_order_of_appearance
from machine_tool_calibration.planning.sensing import Changed, appended, approached, first_repetition, fresh_id
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.description import Description
from machine_tool_calibration.session.method import load
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say, together

# What is done beside measuring, s: only to choose between measurements that are equally good.
_EFFORT = {"swing": 3600.0, "warmer": 3 * 3600.0, "station": 900.0, "turned": 120.0}


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A further measurement, as it is proposed."""

    # short name: again, backwards, both_ways, order, swing, warmer, turned, station, index, diagonal, offset; None if
    # none of those tried does what is wanted
    kind: str | None
    measure: str  # what to measure, in words
    seconds: float | None = None  # time that it takes at the session's own pace; None without a time column
    aside: str = ""  # what comes on top of that time, in words; empty if nothing does


@dataclass(frozen=True, kw_only=True)
class Option(Proposal):
    """A further measurement that could be made."""

    session: Session  # the session followed by it; its displacements are only rough
    first_row: int  # number of its first reading
    # for effects that sit in a part which is turned for it, the angle about Z, rad
    turned: Mapping[str, float] = field(default_factory=dict)

    @property
    def proposal(self) -> dict[str, Any]:
        """The fields of a `Proposal`."""
        return {one.name: getattr(self, one.name) for one in fields(Proposal)}

    @property
    def effort(self) -> float:
        """Time with what comes on top, s, roughly."""
        return (self.seconds or 0.0) + _EFFORT.get(self.kind or "", 0.0)


def mounted_again(session: Session, rows: IntArray) -> tuple[Description, IntArray, str]:
    """The setups of some readings made again: their description, which takes each one's place, what comes on top.

    An instrument that goes from station to station, or a mirror from diagonal to diagonal, is mounted again for any
    further reading: the setup's unknowns are new ones. A part on the rotary table stays. What comes on top is in words.
    """
    description = session.description
    mounted = spec_of(session).mounted(description)
    place = np.arange(len(description.setups))
    if not mounted:
        return description, place, ""
    setups: list[Any] = list(description.setups)
    ids = {setup.id for setup in setups}
    for s in np.unique(session.readings.setup[rows]).tolist():
        name = fresh_id(setups[s].id, ids, "again_")
        ids.add(name)
        place[s] = len(setups)
        setups.append(setups[s].model_copy(update={"id": name}))
    return description.model_copy(update={"setups": tuple(setups)}), place, f"mounting {mounted} again"


_WARMER = 5.0
_SWING = 2.5
_TURNS = (90.0, 45.0)


def further_options(session: Session) -> list[Option]:
    """Further measurements, one repetition each, that this session allows; the simplest first."""
    rows = first_repetition(session)
    if not len(rows):
        return []
    further = spec_of(session).further_places
    places = [] if further is None else load(further)(session, session.description)
    return [*_repeated(session, rows), *places]


def _repeated(session: Session, rows: IntArray) -> Iterator[Option]:
    """The same again, in another way."""
    description, place, mounting = mounted_again(session, rows)
    measure = say("measure.repeat" if np.ptp(session.readings.repeat) else "measure.once_more")

    def option(
        kind: str, how: str, changed: Changed, aside: str = "", turned: dict[str, float] | None = None
    ) -> Option:
        besides = " and ".join(text for text in (mounting, aside) if text)
        extended = appended(session, changed, place[session.readings.setup[changed.rows]], description)
        return Option(kind=kind, measure=together((measure, how), ""), aside=besides, turned=turned or {}, **extended)

    yield option("again", say("measure.as_before"), Changed(rows))
    for kind, found in (
        ("backwards", _backwards(session, rows)),
        ("both_ways", _both_ways(session, rows)),
        ("order", _other_order(session, rows)),
    ):
        if found is not None:
            yield option(kind, found[1], found[0])
    if any(name.startswith("temperature") for name in session.readings.columns):
        # A day's swing while it is measured, and another day.
        swing = _SWING * np.sin(2 * np.pi * np.arange(len(rows)) / max(len(rows), 1))
        how = say("measure.swing", kelvin=f"{_SWING:g}")
        yield option("swing", how, Changed(rows, kelvin=swing), "the temperature must change meanwhile")
        how = say("measure.warmer", kelvin=f"{_WARMER:g}")
        yield option("warmer", how, Changed(rows, kelvin=np.full(len(rows), _WARMER)), "waiting for the temperature")
    part, effects = spec_of(session).turned_part
    for angle in _TURNS if part else ():
        turned = dict.fromkeys(effects, float(np.radians(angle)))
        how = say("measure.turned", part=part, angle=f"{angle:g}")
        yield option("turned", how, Changed(rows), turned=turned)


def _backwards(session: Session, rows: IntArray) -> tuple[Changed, str] | None:
    """The readings in reverse within each run, and the directions of approach that follow."""
    columns = session.readings.columns
    if spec_of(session).probes_surface:
        # A touch comes from outside whatever the order: only the table can be turned the other way.
        if "dir_c" not in columns:
            return None
        changed = Changed(rows, {"dir_c": -columns["dir_c"][rows]})
        return changed, say("measure.other_side")
    group = _runs(session, rows)
    order = np.concatenate([np.flatnonzero(group == g)[::-1] for g in dict.fromkeys(group.tolist())])
    rows, group = rows[order], group[order]
    approaches = _approaches(session, rows, group, -1.0)
    if not approaches and not spec_of(session).states_runs:
        return None
    return Changed(rows, approaches), say("measure.backwards")


def _both_ways(session: Session, rows: IntArray) -> tuple[Changed, str] | None:
    """Every run of a rotary axis followed by the same angles in reverse; None where the runs turn back already."""
    if not spec_of(session).turns_one_axis:
        return None
    group = _runs(session, rows)
    axis = session.description.machine.table_axis.lower()
    angle = np.round(session.readings.columns[axis][rows], 6)
    runs = [np.flatnonzero(group == g) for g in dict.fromkeys(group.tolist())]
    if any(len(np.unique(angle[run])) < len(run) for run in runs):
        return None
    order = np.concatenate([np.concatenate([run, run[::-1]]) for run in runs])
    name = f"dir_{axis}"
    words = say("measure.both_ways")
    if name not in session.readings.columns:
        return Changed(rows[order]), words
    there = session.readings.columns[name][rows]
    # Back at an angle the axis comes from the next one; at the last from beyond it.
    sense = [np.concatenate([there[run], -there[np.append(run, run[-1])[:0:-1]]]) for run in runs]
    return Changed(rows[order], {name: np.concatenate(sense)}), words


def _approaches(session: Session, rows: IntArray, group: IntArray, before: float) -> dict[str, Array]:
    columns = session.readings.columns
    out = {}
    for axis in "xyzabc":
        if axis in columns and f"dir_{axis}" in columns and np.ptp(columns[axis]) > 0:
            old = columns[f"dir_{axis}"][rows]
            out[f"dir_{axis}"] = approached(columns[axis][rows], group, before * old)
    return out


def _runs(session: Session, rows: IntArray) -> IntArray:
    """(k,) runs, numbered."""
    readings = session.readings
    return groups(readings.setup[rows], *(readings.labels[name][rows] for name in readings.labels if name == "target"))


def _other_order(session: Session, rows: IntArray) -> tuple[Changed, str] | None:
    """The grid of targets with that axis moving most often that moved least often."""
    if not spec_of(session).free_order:
        return None
    position = session.readings.position()[rows]
    moves = (np.abs(np.diff(position, axis=0)) > 1e-9).sum(axis=0)
    moving = np.flatnonzero(moves > 0)
    if len(moving) < 2:
        return None
    slow_last = sorted(moving.tolist(), key=lambda j: -moves[j])
    setup = session.readings.setup[rows]
    # Station after station in the order of time, as they were; the last key counts most.
    places = (np.round(position[:, j], 9) for j in reversed(slow_last))
    order = np.lexsort([*places, in_order_of_appearance(setup)])
    rows = rows[order]
    words = say("measure.order", axis="XYZ"[slow_last[-1]])
    return Changed(rows, _approaches(session, rows, setup[order], 1.0)), words
