# SPDX-License-Identifier: Apache-2.0
"""The model of one session, whatever its method."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray
from machine_tool_calibration.errors import ModelError, did_you_mean
from machine_tool_calibration.estimation.problem import LinearPart, group_rows
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.model.own_noise import own_noise
from machine_tool_calibration.model.result import ErrorMap, Rejected
from machine_tool_calibration.session.catalogue import method_names, method_spec, spec_of
from machine_tool_calibration.session.checks.places import misplaced
from machine_tool_calibration.session.checks.suspicion import suspicions
from machine_tool_calibration.session.gaps import without_gaps
from machine_tool_calibration.session.method import load
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import together

VAGUE = 1e-4
"""Standard uncertainty above which a position error counts as not determined, m."""
# The same of readings which are known no better than a tenth of it, over what these scatter by.
_VAGUE_READINGS = 10.0


def model_names(method: str | None = None) -> tuple[str, ...]:
    """Names of the models of a method, the default first; of all methods if None."""
    chosen = method_names() if method is None else (method,)
    return tuple(dict.fromkeys(variant for name in chosen for variant in method_spec(name).models))


def model_of(method: str, name: str | None = None) -> str:
    """The name of a method's model, by default its first one's; a ModelError if it has none of that name."""
    models = method_spec(method).models
    if (name := name or next(iter(models))) not in models:
        hint = did_you_mean(name, models)
        raise ModelError(f"{method} has no model {name!r}{hint}; known are {', '.join(models)}")
    return name


def sharing_variant(session: Session, model: str | None) -> str | None:
    """The variant of a session's model in a fit of several: what was asked for, else tables that others can share."""
    return model if model in spec_of(session).together else spec_of(session).tables


def build_model(session: Session, model: str | None = None) -> tuple[MethodModel, str]:
    """The model of a session, without added effects, and its name.

    A ModelError: no such model for this method, no reading, or the data does not allow it.
    """
    name = model_of(session.method, model)
    if not np.isfinite(session.readings.displacement).any():
        raise ModelError(f"{session.source}: no reading is left")
    built: MethodModel = load(spec_of(session).model).build(without_gaps(session), name)
    noise = own_noise(built.observations, built.declared_sigma)
    return (built if noise is None else replace(built, noise=noise).reestimated()), name


def linear_part(
    model: MethodModel, group: IntArray, reading: Array, block: Array, places: IntArray, dense_index: IntArray
) -> LinearPart:
    """Readings (n,) without points, each of a group (n,) that has unknowns of its own.

    Columns (b, n) are of these, whose places are (groups, b).
    """
    none = np.zeros((0, len(reading)))
    return LinearPart(group_rows(group), reading, model.sigma, none, block, model.dense(), places, dense_index)


def vaguest(fit: Fit) -> float:
    """Standard uncertainty of a position error, m, from which it says nothing of a machine, a linear fit little."""
    return max(VAGUE, _VAGUE_READINGS * fit.joint.birge_ratio * fit.model.observations.session.sigma)


def without_vague(fit: Fit, error: Array, covariance: Array) -> tuple[Array, Array, Array, BoolArray]:
    """Position errors (n, d), their uncertainties and covariance (n, d, d), NaN where they are vague; and where."""
    uncertainty = np.sqrt(np.einsum("nii->ni", covariance))
    vague = uncertainty > vaguest(fit)
    covariance = np.where(vague[:, :, None] | vague[:, None, :], np.nan, covariance)
    return np.where(vague, np.nan, error), np.where(vague, np.nan, uncertainty), covariance, vague


def error_map(fit: Fit) -> ErrorMap:
    """The machine's errors from one session's share in a fit, and what each setup scatters by where they differ."""
    spec = spec_of(fit.model.observations.session)
    found: ErrorMap = load(spec.model).error_map(fit.model, fit)
    if fit.model.noise is None or fit.joint.given is not None:
        return found
    scatter = {**found.content.get("scatter", {}), "each": fit.model.noise.each}
    return replace(found, content={**found.content, "scatter": scatter})


def suspicious_fits(
    fits: Sequence[Fit], labels: Sequence[str] | None = None, sessions: Sequence[Session] | None = None
) -> list[str]:
    """What is suspicious in the sessions of fits, or as measured, in words: also places found elsewhere than stated."""
    named = [""] * len(fits) if labels is None else [f"{label}: " for label in labels]
    own = [fit.model.observations.session for fit in fits]
    found = [
        together((name, one.words), "")
        for name, fit, session in zip(named, fits, own, strict=True)
        if spec_of(session).beam_from_pointer
        for one in misplaced(session, error_map(fit).content)
    ]
    return [*suspicions(sessions or own, labels), *found]


def rejected_readings(session: Session) -> tuple[Rejected, ...]:
    """Readings that no fit uses."""
    missing = np.flatnonzero(~np.isfinite(session.readings.displacement))
    return tuple(Rejected(int(session.readings.row[k]), "the reading is missing") for k in missing)
