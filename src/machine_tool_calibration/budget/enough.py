# SPDX-License-Identifier: Apache-2.0
"""Whether a measurement tells enough: the map's largest U, or whether named effects are there."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from machine_tool_calibration.budget import complete
from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.effects.effect_terms import refuse_idle
from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.progress import untold
from machine_tool_calibration.session.checks import check_session
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.units import quantity

_THERE, _ABSENT = 0.95, 0.05  # probabilities from which an effect counts as there, and up to which as not there
# Share of the largest plausible size that must have been detectable for an effect that is not there.
_DETECTABLE_SHARE = 0.1
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Until:
    """What is to be reached."""

    u: float | None = None  # expanded uncertainty (k = 2) of every coordinate of the map, m; None if not asked for
    told: tuple[str, ...] = ()  # effects that are to be found, or not to be there

    @classmethod
    def parse(cls, text: str, own: Sequence[Effect] = ()) -> Self:
        """From `U=2um` or `told=backlash_y,…`; a SessionError: not of that form, a ModelError: an unknown effect."""
        name, _, value = (part.strip() for part in text.partition("="))
        if name == "U" and value:
            u = quantity(value, "length", "until U")
            if not u > 0.0:
                raise SessionError(f"until U: {value!r} must be positive")
            return cls(u=u)
        if name == "told" and value:
            told = tuple(part.strip() for part in value.split(","))
            find_effects(told, own)  # refuses unknown ones
            return cls(told=told)
        raise SessionError(f"until: {text!r} is neither U=2um nor told=backlash_y,thermal_expansion_x")


@dataclass(frozen=True)
class Reached:
    """What the readings up to some of a setup tell."""

    setup: str  # id of the last one
    readings: int  # so far
    seconds: float | None  # from the first reading to the last; None without a time column
    # largest expanded uncertainty (k = 2) of a coordinate of the map, m; infinite while that is not determined
    u: float = float("inf")
    # of the effects asked for; none as long as the readings do not allow a search
    probabilities: dict[str, float] = field(default_factory=dict)
    enough: bool = False  # whether that is what was to be reached

    def document(self) -> dict[str, Any]:
        """For programs; what is not determined is null."""
        return {
            "setup": self.setup,
            "readings": self.readings,
            "seconds": self.seconds,
            "U": self.u if np.isfinite(self.u) else None,
            "probabilities": self.probabilities,
            "enough": self.enough,
        }


def reached(chosen: FitRequest, until: Until, wanted: int = 1, *, whole: bool = True) -> Reached:
    """What the readings of one session tell, of which so many coordinates of the map are `wanted`.

    They are the `whole` measurement, or part of it: what comes slowly is not called absent after a few minutes.
    """
    session = chosen.sessions[0]
    readings, time = session.readings, session.readings.columns.get("time")
    known = np.zeros(0) if time is None else time[np.isfinite(time)]
    seconds = float(np.ptp(known)) if len(known) else None
    found = Reached(session.setup_ids[int(readings.setup[-1])], len(readings), seconds)
    try:
        check_session(session)  # what can be identified too, if it ends here
        if until.u is not None:
            found_map = complete.identify(chosen).error_map
            u = found_map.largest_expanded if found_map.determined >= wanted else float("inf")
            told = float(f"{u:.1e}")  # two digits (GUM 7.2.6)
            return replace(found, u=u, enough=told <= until.u * (1.0 + _ROUNDING))
        probabilities, enough = _told(chosen, until.told, whole)
        return replace(found, probabilities=probabilities, enough=enough)
    except (CalibrationError, np.linalg.LinAlgError):  # not yet enough for the model
        return found


def determined(chosen: FitRequest) -> int:
    """How many coordinates of the map a session determines."""
    return complete.identify(chosen).error_map.determined


def _told(chosen: FitRequest, names: Sequence[str], whole: bool) -> tuple[dict[str, float], bool]:
    found, _ = complete.diagnose(chosen, progress=untold)
    probabilities, enough = dict.fromkeys(names, 0.0), dict.fromkeys(names, False)
    for one in found.search.findings:
        if one.name in probabilities:
            p = probabilities[one.name] = float(one.probability)
            effect = one.candidate.effect
            limits = {} if effect is None else {c.name: max(abs(c.low), abs(c.high)) for c in effect.coefficients}
            seen = [size <= _DETECTABLE_SHARE * limits.get(name, np.inf) for name, size in one.detectable.items()]
            late = one.candidate.takes_time and not whole
            enough[one.name] = p >= _THERE or (p <= _ABSENT and bool(seen) and all(seen) and not late)
    return probabilities, all(enough.values())


def after_each_setup(chosen: FitRequest, until: Until) -> Iterator[Reached]:
    """What a session told after each of its setups, in the order of its readings.

    All that the whole session determines has to be determined before its U counts; what it does not allow is refused.
    """
    session = chosen.sessions[0]
    refuse_idle(find_effects(until.told, chosen.own), chosen.base(session)[0].observations)
    wanted = determined(chosen)
    for part in parts(session):
        whole = len(part.readings) == len(session.readings)
        yield reached(chosen.instead(0, part), until, wanted, whole=whole)


def parts(session: Session) -> Iterator[Session]:
    """The session up to the end of each setup, in the order of its readings."""
    setup = session.readings.setup
    ends = np.flatnonzero(np.append(setup[1:] != setup[:-1], True)) + 1
    for end in ends:
        yield session.with_readings(session.readings.select(np.arange(end)))
