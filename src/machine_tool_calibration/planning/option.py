# SPDX-License-Identifier: Apache-2.0
"""A further measurement that could be made, and what has to be mounted again for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import IntArray
from machine_tool_calibration.planning.sensing import Changed, appended
from machine_tool_calibration.session.description import Description
from machine_tool_calibration.session.session import Session

__all__ = ["Mounting", "Option", "mounted_again"]


# What is done beside measuring, s: only to choose between measurements that are equally good.
_EFFORT = {"swing": 3600.0, "warmer": 3 * 3600.0, "station": 900.0, "turned": 120.0}


@dataclass(frozen=True)
class Option:
    """A further measurement that could be made.

    Attributes:
        kind: short name: again, backwards, both_ways, order, swing, warmer, turned, station, index, diagonal, offset.
        words: what to do, for people.
        session: the session followed by it; its displacements are only rough.
        first_row: number of its first reading.
        seconds: time that it takes at the session's own pace; None without a time column.
        aside: what comes on top of that time, in words; empty if nothing does.
        turned: for effects that sit in a part which is turned for it, the angle about Z, rad.
    """

    kind: str
    words: str
    session: Session
    first_row: int
    seconds: float | None
    aside: str = ""
    turned: Mapping[str, float] = field(default_factory=dict)

    @property
    def effort(self) -> float:
        """Time with what comes on top, s, roughly."""
        return (self.seconds or 0.0) + _EFFORT.get(self.kind, 0.0)

    @classmethod
    def of(
        cls,
        session: Session,
        kind: str,
        words: str,
        extended: tuple[Session, float | None],
        aside: str = "",
        turned: Mapping[str, float] | None = None,
    ) -> Option:
        """An option from the session as it was and as it would be."""
        first = int(session.readings.row.max(initial=-1)) + 1
        return cls(kind, words, extended[0], first, extended[1], aside, turned or {})


@dataclass(frozen=True)
class Mounting:
    """How setups are made again.

    Attributes:
        session: what was measured.
        description: with the setups made again; they have unknowns of their own.
        place: the new setup of each old one; the same where nothing has to be mounted.
        words: to be put behind "measure … once more".
        aside: what comes on top of the measuring time.
    """

    session: Session
    description: Description
    place: dict[int, int]
    words: str
    aside: str

    def added(self, changed: Changed) -> tuple[Session, float | None]:
        """The session with further readings in the setups made again, and their time, s."""
        setup = self.session.readings.setup[changed.rows]
        new = np.array([self.place.get(int(s), int(s)) for s in setup], dtype=np.int64)
        return appended(self.session, changed, setup=new, description=self.description)


def mounted_again(session: Session, rows: IntArray) -> Mounting:
    """The setups of some readings made again.

    An instrument that goes from station to station, or a mirror from diagonal to diagonal, has to be mounted again for
    any further reading: then the setup's unknowns are new ones. A part on the rotary table stays where it is.
    """
    description = session.description
    mounted = session.spec.mounted(description)
    if not mounted:
        return Mounting(session, description, {}, "", "")
    setups: list[Any] = list(description.setups)
    ids = {setup.id for setup in setups}
    place = {}
    for s in sorted(set(session.readings.setup[rows].tolist())):
        # In front, because the end of an id may state the order of the moves.
        name = f"again_{setups[s].id}"
        while name in ids:
            name = f"again_{name}"
        ids.add(name)
        place[int(s)] = len(setups)
        setups.append(setups[s].model_copy(update={"id": name}))
    new = description.model_copy(update={"setups": tuple(setups)})
    return Mounting(session, new, place, "", f"mounting {mounted} again")
