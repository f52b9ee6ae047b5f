# SPDX-License-Identifier: Apache-2.0
"""What would be known after a further measurement, beside what is known now."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect_terms import add_effects
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.model.fit import JointFit, fit_models
from machine_tool_calibration.model.refits import declared
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.planning.detectable import Detectable, detectable
from machine_tool_calibration.planning.dominant import expected_model
from machine_tool_calibration.planning.forecast import Forecast
from machine_tool_calibration.planning.options import further_options
from machine_tool_calibration.session.session import Readings, Session

__all__ = ["Outlook", "current", "outlook_of", "outlooks"]


@dataclass(frozen=True)
class Outlook:
    """What is known of the machine after a measurement, if its readings scatter as declared.

    Attributes:
        words: what to measure; empty for what is known now.
        session: the readings to be taken, with displacements that are none; of what is known now those that were.
        places: (k, 3) where the readings are taken, m.
        points: (n, 3) places of the map, m.
        uncertainty: (n, 3) standard uncertainty of its position errors, m; NaN where not determined.
        detectable: the smallest sizes of effects that would be found.
        seconds: time of motion and waiting; None where no time was recorded.
        aside: what comes on top of that time, in words.
    """

    words: str
    session: Session
    places: Array
    points: Array
    uncertainty: Array
    detectable: Detectable
    seconds: float | None = None
    aside: str = ""

    @property
    def typical(self) -> float:
        """Root mean square standard uncertainty of the map's coordinates, m; NaN where there is none.

        Neither what is not determined nor what the datum fixes counts.
        """
        square = self.uncertainty**2
        known = square[np.isfinite(square) & (square > 0)]
        return float(np.sqrt(np.mean(known))) if len(known) else float("nan")


def outlook_of(found: Forecast, words: str) -> Outlook:
    """That of a procedure that is run by itself.

    Args:
        found: its forecast.
        words: what it is called.
    """
    observations, error_map = found.result.fit.model.observations, found.result.error_map
    shown = Detectable(found.visible, found.absorbed, found.excluded)
    return Outlook(
        words,
        _to_be_read(observations.session, observations.readings),
        observations.position,
        error_map.points,
        error_map.uncertainty,
        shown,
        found.seconds,
    )


@single_blas()
def current(chosen: FitRequest) -> Outlook:
    """What is known now."""
    joint, error_map = _fitted(chosen)
    places = np.concatenate([fit.model.observations.position for fit in joint.fits])
    shown = detectable(joint, chosen.absent)
    return Outlook("", chosen.sessions[0], places, error_map.points, error_map.uncertainty, shown)


@single_blas()
def outlooks(chosen: FitRequest, progress: Callable[[str, float], object] = lambda what, share: None) -> list[Outlook]:
    """What is known now, and what would be after each further measurement that the sessions allow.

    Args:
        chosen: what was measured, and the model.
        progress: told what is being done, and the share that is finished.

    Returns:
        That of now first; those that would make the map better best first.
    """
    progress("what is known now", 0.0)
    now, labels = current(chosen), chosen.labels
    options = [(k, option) for k, session in enumerate(chosen.sessions) for option in further_options(session)]
    then = []
    for number, (k, option) in enumerate(options, 1):
        progress("what further measurements would tell", number / (len(options) + 1))
        try:
            joint, error_map = _fitted(chosen.instead(k, option.session))
        except (CalibrationError, np.linalg.LinAlgError):
            continue
        observations = joint.fits[k].model.observations
        new = observations.readings.row >= option.first_row
        then.append(
            Outlook(
                option.words if labels is None else f"{labels[k]}: {option.words}",
                _to_be_read(option.session, observations.readings.select(new)),
                observations.position[new],
                error_map.points,
                error_map.uncertainty,
                detectable(joint, chosen.absent),
                option.seconds,
                option.aside,
            )
        )
    return [now, *sorted(then, key=lambda one: np.nan_to_num(one.typical, nan=np.inf))]


def _to_be_read(session: Session, readings: Readings) -> Session:
    """A session with the places of readings, and without what was read there."""
    return session.with_readings(replace(readings, displacement=np.full(len(readings), np.nan)))


def _fitted(chosen: FitRequest) -> tuple[JointFit, ErrorMap]:
    """The fit, and its map with the uncertainties that follow from the declared one alone."""
    if len(chosen.sessions) > 1:
        fitted = fit_sessions(chosen)
        return fitted.joint, fitted.map_of(declared(fitted.joint))
    joint = fit_models([add_effects(expected_model(chosen.sessions[0], chosen.model), chosen.present)])
    return joint, joint.assembly.models[0].error_map(declared(joint).fits[0])
