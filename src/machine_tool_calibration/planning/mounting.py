"""Measuring again what was measured: what has to be mounted again, and the unknowns that this brings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import IntArray
from machine_tool_calibration.planning.rows import Changed, appended
from machine_tool_calibration.session.description import Description, Direct
from machine_tool_calibration.session.session import Session

__all__ = ["Mounting", "mounted_again"]

_MOUNTED = {
    "step_diagonal": "the mirror",
    "tracking_interferometer": "the instrument",
    "rotary_axis": "the instrument",
    "direct": "the instrument or part",
}


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
    absolute = isinstance(description, Direct) and description.datum == "none"
    if session.method == "probing" or absolute:
        return Mounting(session, description, {}, "", "")
    setups: list[Any] = list(description.setups)
    ids = {setup.id for setup in setups}
    place = {}
    for s in sorted(set(session.readings.setup[rows].tolist())):
        # In front, because the end of an id may tell the order of the moves.
        name = f"again_{setups[s].id}"
        while name in ids:
            name = f"again_{name}"
        ids.add(name)
        place[int(s)] = len(setups)
        setups.append(setups[s].model_copy(update={"id": name}))
    new = description.model_copy(update={"setups": tuple(setups)})
    return Mounting(session, new, place, "", f"mounting {_MOUNTED[session.method]} again")
