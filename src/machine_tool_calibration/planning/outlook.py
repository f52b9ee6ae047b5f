# SPDX-License-Identifier: Apache-2.0
"""What would be known after a further measurement, beside what is known now."""

from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect_terms import add_effects
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.build import error_map
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.methods.identify import JointResult, fitted_sessions
from machine_tool_calibration.methods.map_comparison import common_points, states
from machine_tool_calibration.model.fit import JointFit, declared, fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.model.result import ErrorMap, Result, map_rms
from machine_tool_calibration.planning.dominant import angular_size, expecting
from machine_tool_calibration.planning.forecast import Forecast
from machine_tool_calibration.planning.options import Option, further_options
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.session.session import Readings, Session

# Standard uncertainty of readings that are to say nothing of the machine, m: thousands of times that of an instrument.
_SILENT_UNCERTAINTY = 1e-3
_NEAR = 1e-3  # how far one place may be found from itself by other readings, m


@dataclass(frozen=True)
class Outlook:
    """What is known of the machine after a measurement."""

    words: str  # what to measure; empty for what is known now
    session: Session  # the readings to be taken, with displacements that are none; of what is known now those that were
    places: Array  # (k, 3) where the readings are taken, m; none of what is known now
    points: Array  # (n, 3) places of the map, m
    uncertainty: Array  # (n, 3) standard uncertainty of its position errors, m; NaN where not determined
    seconds: float | None = None  # time of motion and waiting; None where no time was recorded
    aside: str = ""  # what comes on top of that time, in words

    @property
    def typical(self) -> float:
        """RMS length of the map's standard uncertainty, m, as it is published of a map; NaN where there is none."""
        size = map_rms(self.uncertainty)
        return float("nan") if size is None else size

    @property
    def largest(self) -> float:
        """Largest standard uncertainty of one of its coordinates, m; NaN where none is determined."""
        known = self.uncertainty[np.isfinite(self.uncertainty)]
        return float(known.max()) if len(known) else float("nan")


def outlook_of(found: Forecast, words: str) -> Outlook:
    """That of a procedure that is run by itself, from its forecast."""
    observations, error_map = found.result.fit.model.observations, found.result.error_map
    read = _to_be_read(observations.session, observations.readings)
    return Outlook(words, read, observations.position, error_map.points, error_map.uncertainty, found.seconds)


def current(session: Session, published: ErrorMap) -> Outlook:
    """What is known now: the map as it is published."""
    return Outlook("", session, np.zeros((0, 3)), published.points, published.uncertainty)


@single_blas()
def outlooks(chosen: FitRequest, result: Result | JointResult, progress: Progress = untold) -> list[Outlook]:
    """What is known now, and what would be after each further measurement that the sessions allow.

    The published uncertainty of each coordinate shrinks as the one that follows from the declared uncertainty does:
    further readings are taken to scatter, and not to reproduce, as those did. That of now comes first; then those that
    would make the map better best first, of equals that with the least effort.
    """
    progress("what is known now", 0.0)
    labels, published = chosen.labels, result.error_map
    read = fitted_sessions(result).error_map.uncertainty
    angular = angular_size(result.joint.assembly.models[0])
    now = _fitted(chosen, angular, chosen.base(chosen.sessions[0])[0])[1].uncertainty
    options = [(k, option) for k, session in enumerate(chosen.sessions) for option in further_options(session)]
    then: dict[tuple[int, int, str], tuple[float, Outlook]] = {}
    for number, (k, option) in enumerate(options, 1):
        progress("what further measurements would tell", number / (len(options) + 1))
        try:
            joint, error_map = _with(chosen, k, option, angular)
        except (CalibrationError, np.linalg.LinAlgError):
            continue
        observations = joint.fits[k].model.observations
        # A map of several sessions gets places more, and targets are found elsewhere, by less than they are apart.
        after = np.full_like(now, np.nan)
        before, found_at = (states(own.points, own.content) for own in (published, error_map))
        mine, theirs = common_points(before, found_at, within=_NEAR)
        after[mine] = error_map.uncertainty[theirs]
        new = observations.readings.row >= option.first_row
        words = option.measure if labels is None else f"{labels[k]}: {option.measure}"
        further = _to_be_read(option.session, observations.readings.select(new))
        # What the datum fixes is known before and after, and what a budget adds to the readings stays.
        stays = np.maximum(published.uncertainty**2 - read**2, 0.0)
        u = np.sqrt(stays + (read * np.divide(after, now, out=np.ones_like(now), where=now != 0.0)) ** 2)
        places = observations.position[new]
        found = Outlook(words, further, places, published.points, u, option.seconds, option.aside)
        alike = k, int(new.sum()), f"{found.typical:.3g}"
        if alike not in then or option.effort < then[alike][0]:
            then[alike] = option.effort, found
    best_first = sorted((one for _, one in then.values()), key=lambda one: np.nan_to_num(one.typical, nan=np.inf))
    return [current(chosen.sessions[0], published), *best_first]


def _to_be_read(session: Session, readings: Readings) -> Session:
    """A session with the places of readings, and without what was read there."""
    return session.with_readings(replace(readings, displacement=np.full(len(readings), np.nan)))


def _with(chosen: FitRequest, at: int, option: Option, angular: float) -> tuple[JointFit, ErrorMap]:
    """The fit with a further measurement in one of the sessions."""
    session, old = option.session, chosen.sessions[at]
    known = chosen.base(old)[0]
    said = session.description.standard_uncertainty
    silent = {
        name: said.model_copy(update={"displacement": _SILENT_UNCERTAINTY})
        for name in session.setup_ids[len(old.setup_ids) :]
    }
    if silent:
        # Those of a perfect machine with everything where it is stated would pull the fit, and with it the geometry on
        # which the uncertainty rests: what the present readings predict is read there.
        hardly = said.model_copy(update={"setups": {**said.setups, **silent}})
        description = session.description.model_copy(update={"standard_uncertainty": hardly})
        fit = _fitted(chosen.instead(at, replace(session, description=description)), angular, known)[0].fits[at]
        rows, there = session.readings.row, fit.model.observations.readings.row
        missed = np.zeros(len(rows))
        missed[np.searchsorted(rows, there)] = fit.residuals
        predicted = session.readings.displacement - np.where(rows >= option.first_row, missed, 0.0)
        session = session.with_readings(replace(session.readings, displacement=predicted))
    return _fitted(chosen.instead(at, session), angular, known)


def _fitted(chosen: FitRequest, angular: float, known: MethodModel) -> tuple[JointFit, ErrorMap]:
    """The fit, and its map with the uncertainties that follow from the declared one alone.

    Readings that were not taken say nothing of their noise: it is that `known` by those that were.
    """
    if len(chosen.sessions) > 1:
        fitted = fit_sessions(chosen)
        return fitted.joint, fitted.map_of(declared(fitted.joint))
    model = replace(chosen.base(chosen.sessions[0])[0], noise=None).drawn_as(known)
    model = expecting(model, angular)
    joint = fit_models([add_effects(model, chosen.present)])
    return joint, error_map(declared(joint).fits[0])
