# SPDX-License-Identifier: Apache-2.0
"""Stations and targets that are found elsewhere than they are stated to be."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, best_motion
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import figures, say

# A place may be off by so many of its stated standard uncertainties, but at least by this, and by that where none is
# stated, m: beyond, another place is meant. Beyond the former and so many of its own, it is said.
_DECLARED, _LEAST_OFF, _UNDECLARED = 10.0, 0.01, 0.1
_KNOWN = 5.0
_FOUND = 0.15  # as far as this, m, readings of a rotary axis place stations and targets by themselves
_FRAME = 3  # stations of an axis stand in its own frame: fewer fix only the motion between that and the machine's


@dataclass(frozen=True)
class Misplaced:
    """A station or target that is not found where it is stated to be."""

    what: str  # it is, `station` or `target`
    id: str  # its own
    off: float  # how far, m
    along: str  # on which axis the most
    uncertainty: float  # standard uncertainty of that distance, the stated one within, m
    declared: float | None  # standard uncertainty that is stated; None where none is

    @property
    def words(self) -> str:
        """Where it is found, and what was stated."""
        known = say("suspicion.known", size=figures(1e3 * self.declared)) if self.declared else say("suspicion.unknown")
        what, off = say(f"suspicion.{self.what}"), figures(1e3 * self.off)
        return say("suspicion.elsewhere", what=what, id=repr(self.id), off=off, known=known, along=self.along)


def allowed(session: Session, declared: float | None) -> float:
    """By how much a place of that stated standard uncertainty may be off, m."""
    if spec_of(session).turns_one_axis:
        return max(_DECLARED * (declared or 0.0), _FOUND)
    return _UNDECLARED if declared is None else max(_DECLARED * declared, _LEAST_OFF)


def misplaced(session: Session, found: Mapping[str, Any]) -> Iterator[Misplaced]:
    """Places off by more than their uncertainties make likely, the farthest off first.

    `found` has `stations` and `targets`, each (k, 3) in the order of the description, m, with standard
    uncertainties `stations_u`, `targets_u`; NaN of what is not determined. Those that it lacks are not judged.
    """
    out = []
    for key, name, word in (("stations", "setups", "station"), ("targets", "targets", "target")):
        if key not in found or not hasattr(session.description, name):
            continue
        entries = getattr(session.description, name)
        nominal = np.array([entry.position for entry in entries])
        own = spec_of(session).turns_one_axis and key == "stations"
        places, u = np.asarray(found[key]), np.asarray(found.get(f"{key}_u", np.zeros(nominal.shape)))
        away = off_declared(places, nominal) if own else places - nominal
        away = np.where(np.isfinite(away), away, 0.0)[:, : len(session.description.axes)]
        for entry, one, own_u in zip(entries, away, u, strict=True):
            j = int(np.argmax(np.abs(one)))
            declared = entry.position_uncertainty
            whole = float(np.hypot(own_u[j] if np.isfinite(own_u[j]) else 0.0, declared or 0.0))
            size = float(np.linalg.norm(one))
            if size > (_DECLARED * whole if declared else _UNDECLARED) and abs(one[j]) > _KNOWN * whole:
                out.append(Misplaced(word, entry.id, size, "xyz"[j], whole, declared))
    yield from sorted(out, key=lambda one: -one.off)


def refuse_misplaced(session: Session, found: Mapping[str, Any]) -> None:
    """Refuse (ModelError) places that are found where no survey errs by as much; arguments as for `misplaced`."""
    for one in misplaced(session, found):
        if one.off > allowed(session, one.declared):
            raise ModelError(
                f"{session.source}: {one.words}: check its position and position_uncertainty, and the columns that say "
                "where was read"
            )


def off_declared(found: Array, declared: Array) -> Array:
    """(k, 3) places off the stated ones, by the motion in which all but one agree best, m; 0 of three or fewer."""
    if len(found) <= _FRAME or not np.isfinite(found).all():
        return np.zeros(found.shape)
    off = []
    for k in range(len(found)):
        others = np.arange(len(found)) != k
        turn, shift = best_motion(found[others], declared[others])
        away = found @ turn.T + shift - declared
        off.append((float(np.linalg.norm(away[others])), away))
    return min(off, key=lambda pair: pair[0])[1]
