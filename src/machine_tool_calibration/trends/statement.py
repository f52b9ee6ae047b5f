# SPDX-License-Identifier: Apache-2.0
"""What one measurement states of the machine, so that it can be held against another one of the same machine."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.budget.conformity import VOLUMETRIC, conformity
from machine_tool_calibration.budget.published import (
    POSITION_ERROR,
    Numbers,
    everything,
    figure_of,
    numbers,
    of_document,
)
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.machine.error_motions import ERROR_MOTIONS, SQUARENESS, parse_motion
from machine_tool_calibration.methods.fitted import FittedSessions
from machine_tool_calibration.methods.identify import JointResult, fitted_sessions
from machine_tool_calibration.methods.map_comparison import DRAWS, states
from machine_tool_calibration.model.fit import drawn
from machine_tool_calibration.model.result import Result, beside_reversal, effect_estimates
from machine_tool_calibration.progress import Progress, untold

LOCATION = re.compile(r"[XYZABC]0[XYZABC]")
"""Names of squareness, position and orientation errors of axes (ISO 230-1, 3.6)."""
SCATTER = "scatter"
"""Name of the ratio by which the readings scatter about the model, over what was declared."""
_FIGURES = (*ERROR_MOTIONS, *SQUARENESS, "B_mean", "R", "G_ccw", "G_cw", "G_b", "H", VOLUMETRIC)
_ANY = 1.0  # so large a tolerance that it decides nothing: the figures and their uncertainty are asked for


@dataclass(frozen=True)
class Size:
    """The size of one error."""

    name: str  # error motion, squareness, `B_mean_X`, `R_X`, `G_b`, `volumetric`, `SCATTER` or an effect's coefficient
    value: float  # in the unit
    # standard uncertainty as the readings show it. What the instrument adds in every session alike is no part of it,
    # since it is none of a change.
    u: float
    unit: str  # SI


def sizes_of(result: Result | JointResult, progress: Progress = untold) -> tuple[Size, ...]:
    """All sizes that a result determines, with an uncertainty."""
    fitted = fitted_sessions(result)
    found = conformity(fitted, dict.fromkeys(_FIGURES, _ANY), progress=progress)
    sizes = [Size(one.name, one.value, one.u, one.unit) for one in found.each]
    published = everything(fitted)
    for quantity in published.quantities:
        if quantity.count == 1 and LOCATION.fullmatch(quantity.name):
            value, u = (float(values[quantity.first]) for values in (published.value, published.u))
            sizes.append(Size(quantity.name, value, u, quantity.unit))
    for estimate in effect_estimates(fitted.joint, fitted.effects):
        sizes.append(Size(estimate.name, estimate.value, estimate.standard_uncertainty, estimate.unit))
    ratio, dof = np.sqrt(fitted.joint.reduced_chi_square), fitted.joint.solution.degrees_of_freedom
    sizes.append(Size(SCATTER, float(ratio), float(ratio / np.sqrt(2.0 * dof)), "1"))  # what the model lacks shows here
    once = {size.name: size for size in sizes if np.isfinite(size.value) and np.isfinite(size.u) and size.u > 0}
    return tuple(once.values())


@dataclass(frozen=True)
class Part:
    """An error motion, or a single number such as a squareness."""

    name: str  # as in ISO 230-1, `B_mean_X`, or an effect's coefficient
    unit: str  # m, rad or another one of SI
    members: IntArray  # (k,) places in the vector of published numbers
    at: Array | None  # (k,) positions on the axis, m or rad; None of a single number

    @property
    def datum(self) -> Array:
        """(k, r) columns of what the coordinate system can change: zero, a straightness's slope (ISO 230-1, 3.4)."""
        if self.at is None:
            return np.zeros((1, 0))
        ones = np.ones(len(self.at))
        turns = self.name in ERROR_MOTIONS and parse_motion(self.name).is_straightness
        return np.stack([ones, self.at - self.at.mean()] if turns else [ones], axis=1)


@dataclass(frozen=True)
class Statement:
    """What a measurement states."""

    label: str  # its name
    date: str | None  # when it was measured; None where nothing says it
    method: str  # of the measurement
    model: str  # variant of the method's model
    effects: tuple[str, ...]  # ids of the effects in it
    sha256: str  # of the data
    numbers: Numbers  # values and standard uncertainties
    points: Array  # (n, 3) places of the position error, m, or (n, 6) with senses of approach; may be none
    parts: Mapping[str, Part]  # error motions and single numbers by name
    absolute: bool = False  # whether no datum leaves a motion of the position errors open
    # weighted mean square of the residuals about its own model, and their degrees of freedom; 1 and 0 if not known
    scatter: tuple[float, int] = (1.0, 0)
    # (draws, M') deviations of the first numbers, drawn together; None of a document, which has no correlations
    samples: Array | None = field(default=None, repr=False)

    @property
    def position_error(self) -> tuple[Array, Array]:
        """(n, 3) position error at the points and its standard uncertainty, m; only where there are points."""
        members = self.numbers.quantity(POSITION_ERROR).members
        return self.numbers.value[members].reshape(-1, 3), self.numbers.u[members].reshape(-1, 3)


def of_fit(
    fitted: FittedSessions, label: str, *, draws: int = DRAWS, seed: int = 1, progress: Progress = untold
) -> Statement:
    """What an identified session states, its correlations carried by draws: each u is told to 1 / sqrt(2 draws)."""
    fitted = fitted.at_reference
    published, origin = everything(fitted), fitted.provenance
    samples = np.zeros((draws, len(numbers(fitted, fitted.joint).value)))
    # Each measurement has draws of its own: with the same ones two of them would seem to err together.
    rng = np.random.default_rng([seed, int(origin.sha256[:16], 16)])
    for k, joint in enumerate(drawn(fitted.joint, rng, draws)):
        progress(label, k / draws)
        samples[k] = numbers(fitted, joint).value - published.value[: samples.shape[1]]
    samples *= beside_reversal(fitted.error_map.content)
    return Statement(
        label=label,
        date=origin.sessions[0].measured,
        method=fitted.joint.fits[0].model.observations.session.method,
        model=fitted.model_name,
        effects=fitted.effects,
        sha256=origin.sha256,
        numbers=published,
        points=states(fitted.error_map.points, fitted.error_map.content),
        parts=_parts(published, fitted.error_map.content, fitted.effects),
        absolute=bool(fitted.error_map.content.get("absolute")),
        scatter=_scatter(fitted.joint.reduced_chi_square, fitted.joint.solution.degrees_of_freedom),
        samples=samples,
    )


def of_result(document: Mapping[str, Any], label: str) -> Statement:
    """What a result document states, without correlations; a CalibrationError: not of one session, or damaged."""
    if document.get("format") != "mtcal-result/1" or document.get("method") == "joint":
        raise CalibrationError(f"{label}: is no result document (mtcal-result/1) of one session")
    if "provenance" not in document or "model" not in document:
        raise CalibrationError(f"{label}: says neither its model nor what it was made from: of a formulation, or old")
    try:
        return _read(document, label)
    except CalibrationError as error:
        raise CalibrationError(f"{label}: {error}") from None
    except (AttributeError, LookupError, OverflowError, TypeError, ValueError) as error:
        why = f"{type(error).__name__}: {error}"
        raise CalibrationError(f"{label}: is damaged, or no result document of mtcal ({why})") from None


def _read(document: Mapping[str, Any], label: str) -> Statement:
    content, origin = document.get("error_map") or {}, document["provenance"]
    published = of_document(document)
    points = np.zeros((0, 3))
    if POSITION_ERROR in published.by_name:
        found = np.asarray(content["points"] if "points" in content else content["grid"], dtype=np.float64)
        points = np.pad(found, ((0, 0), (0, 3 - found.shape[1])))
        if 3 * len(points) != published.by_name[POSITION_ERROR].count:
            raise ValueError("the map has as many errors as points")
    where = states(points, content)
    if len(np.unique(where, axis=0)) < len(where):
        where = where[:0]  # in states of time or temperature that the document does not tell apart
    return Statement(
        label=label,
        date=origin["sessions"][0]["measured"],
        method=document["method"],
        model=document["model"],
        effects=tuple(document["effects"]),
        sha256=origin["sha256"],
        numbers=published,
        points=where,
        parts=_parts(published, content, document["effects"]),
        absolute=bool(content.get("absolute")),
        scatter=_scatter(document.get("reduced_chi_square"), document.get("degrees_of_freedom")),
    )


def _scatter(mean_square: float | None, dof: int | None) -> tuple[float, int]:
    known = mean_square is not None and dof is not None and dof > 0 and np.isfinite(mean_square)
    return (float(mean_square), int(dof)) if known else (1.0, 0)  # type: ignore[arg-type]


def _parts(published: Numbers, content: Mapping[str, Any], effects: Sequence[str]) -> dict[str, Part]:
    """Error motions along their axes, also those that stand as profiles of position errors, and single numbers."""
    found: list[Part] = []
    for quantity in published.quantities:
        name, members = quantity.name, np.arange(quantity.first, quantity.first + quantity.count)
        if name in "xyz" and f"{name}_position" in content:
            at = np.asarray(content[f"{name}_position"], dtype=np.float64)
            for j, component in enumerate("XYZ"):
                found.append(Part(f"E{component}{name.upper()}", "m", members[j::3], at))
        elif name in ERROR_MOTIONS and quantity.count > 1 and quantity.at is not None:
            found.append(Part(name, quantity.unit, members, quantity.at))
        elif quantity.count == 1:
            of_axes = name in SQUARENESS or LOCATION.fullmatch(name) or figure_of(name) == "B_mean"
            if of_axes or name.partition(".")[0] in effects:
                found.append(Part(name, quantity.unit, members, None))
    return {part.name: part for part in found}
