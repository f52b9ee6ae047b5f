"""What a procedure will tell, before it is run: uncertainties, gaps, and the smallest effects that it could find."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.diagnosis.candidates import effect_candidates
from machine_tool_calibration.diagnosis.findings import smallest_signal
from machine_tool_calibration.diagnosis.pool import Pool
from machine_tool_calibration.diagnosis.priors import EFFECT
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.fit import Fit, screen
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.planning.dominant import ANGULAR, DRIFT, Dominant, dominant
from machine_tool_calibration.planning.planned import planned_session
from machine_tool_calibration.procedure.description import Procedure

__all__ = ["Forecast", "Visible", "forecast"]

# Share of a column's squared norm that the model must leave for the effect to be seen.
_SEEN = 1e-4
_POWER = 0.8


@dataclass(frozen=True)
class Visible:
    """The smallest size of an effect that a plan finds with a power of 80 %.

    Attributes:
        effect: its id.
        coefficient: the one of its coefficients that is seen best, the others being zero.
        size: smallest detectable size, in the unit; None if the model's own unknowns take the effect up.
        unit: SI.
        reading: largest change of a reading that this makes, m.
    """

    effect: str
    coefficient: str
    size: float | None
    unit: str
    reading: float | None


@dataclass(frozen=True)
class Forecast:
    """What a measurement will tell.

    Attributes:
        result: as it will be for a machine without errors: its uncertainties and gaps are those to come.
        seconds: of motion and waiting.
        visible: effects that it could show, the catalogue's order.
        absorbed: effects that the model takes up.
        excluded: effects that cannot act here, with the reason.
        warming: K per hour that was assumed.
        dominant: what will dominate the map's uncertainty, with angular errors and a drift of the sizes assumed.
    """

    result: Result
    seconds: float
    visible: tuple[Visible, ...]
    absorbed: tuple[str, ...]
    excluded: dict[str, str]
    warming: float
    dominant: Dominant | None = None

    def document(self) -> dict[str, Any]:
        """For programs."""
        found = self.result.document()
        return {
            "format": "mtcal-plan/1",
            "method": found["method"],
            "model": found["model"],
            "readings": found["observations"],
            "seconds": self.seconds,
            "degrees_of_freedom": found["degrees_of_freedom"],
            "uncertainties": {name: value for name, value in found["error_map"].items() if name.endswith("_u")},
            "points": found["error_map"].get("points"),
            "not_determined": found["not_determined"],
            "datum": found["datum"],
            "detectable": [
                {"effect": v.effect, "coefficient": v.coefficient, "size": v.size, "unit": v.unit, "reading": v.reading}
                for v in self.visible
            ],
            "absorbed": list(self.absorbed),
            "excluded": self.excluded,
            "dominant": None if self.dominant is None else self.dominant.document(),
            "power": _POWER,
            "assumed": {"warming_per_hour": self.warming, "spread_between_setups": 0.0, "machine": "without errors"},
        }


def forecast(
    procedure: Procedure,
    *,
    model: str | None = None,
    own: Sequence[Effect] = (),
    warming: float = 1.0,
    angular: float = ANGULAR,
) -> Forecast:
    """What a procedure will tell, if its readings scatter as declared and mountings add no spread.

    Args:
        procedure: what is to be measured.
        model: variant of the method's model.
        own: the user's own effects, beside the catalogue.
        warming: change of the air's temperature that is assumed, K per hour.
        angular: root mean square of the machine's angular errors that is assumed for what dominates, rad.

    Raises:
        SessionError: the procedure cannot be run.
        ModelError: it does not allow the model.
    """
    planned = planned_session(procedure, warming)
    result = identify(planned.session, model=model, keep_all=True)
    fit = result.fit
    candidates, excluded = effect_candidates(Pool(fit.joint), list(catalogue(own).values()))
    needed = float(np.log(max(len(candidates), 1.0 / EFFECT)))
    visible, absorbed = [], []
    stacked = [block.columns for candidate in candidates for block in candidate.shapes]
    each = iter(_outside(fit, stacked))
    for candidate in candidates:
        effect = candidate.effect
        assert effect is not None
        best: Visible | None = None
        for block in candidate.shapes:
            inner, seen = next(each)
            named = block.coefficients
            strength = inner * np.array([max(abs(c.low), abs(c.high)) / 2.0 for c in named]) ** 2
            for k in np.flatnonzero(seen):
                signal = smallest_signal(strength[seen], float(strength[k]), needed + np.log(candidate.count), _POWER)
                size = float(signal / np.sqrt(inner[k]))
                reading = size * float(np.abs(block.columns[k]).max())
                if best is None or best.reading is None or reading < best.reading:
                    best = Visible(effect.id, named[k].name, size, named[k].unit, reading)
        if best is None:
            absorbed.append(effect.id)
        else:
            visible.append(best)
    limits = dominant(planned.session, model=model, angular=angular, drift=DRIFT * abs(warming))
    return Forecast(result, planned.seconds, tuple(visible), tuple(absorbed), excluded, warming, limits)


def _outside(fit: Fit, stacked: Sequence[Array]) -> list[tuple[Array, BoolArray]]:
    """Of each block of (k, n) columns the squared norms outside the model, and which are seen at all.

    In one pass: the model is the same for all.
    """
    projected = screen(fit, np.concatenate([np.zeros((0, len(fit.model.observations))), *stacked]))
    inner = np.diag(projected.gram)[:-1]
    seen = np.asarray(inner > _SEEN * projected.squares[:-1])
    ends = np.cumsum([len(columns) for columns in stacked])
    return list(zip(np.split(inner, ends)[:-1], np.split(seen, ends)[:-1], strict=True))
