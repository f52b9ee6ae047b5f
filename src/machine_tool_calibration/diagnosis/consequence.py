# SPDX-License-Identifier: Apache-2.0
"""What adding an effect does to the residuals and to the machine's map."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

from machine_tool_calibration.arrays import Array, rms
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.diagnosis.search.findings import Finding
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.fitted import FittedSessions, fit_sessions
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.result import Estimate, effect_estimates, effect_signal, map_change
from machine_tool_calibration.residuals.pool import Pool

Added = Callable[[FittedSessions], Mapping[str, float]]
"""What a budget adds to the variance of a fit's unknowns, by name."""

# How many of the best candidates are added in full, each by itself.
_MOST_ADDED = 4
# Uncertainty over size of an effect's share in the readings, above which it is not stated.
_MOST_RELATIVE_U = 0.3


@dataclass(frozen=True)
class Consequence:
    """An effect added to the model."""

    parameters: tuple[Estimate, ...]  # its coefficients, with the names under which an identification publishes them
    # (n,) what it changes in the readings, m; None where the data tell only a part of that from the model's own
    # unknowns
    signal: Array | None
    rms_before: float  # RMS residual without it, m
    rms_after: float  # RMS residual with it, m
    # RMS length by which the position errors of the map's points change, m; None where the method's map has none in
    # common
    map_change_rms: float | None
    explained: Array  # (n,) what it takes out of the residual of each reading, m


@single_blas()
def consequences(
    diagnosis: Diagnosis, added: Added = lambda fitted: {}, most: int = _MOST_ADDED
) -> dict[str, Consequence]:
    """What each of the best candidates would change; of those accepted, what each did change, in their order.

    The coefficients of accepted effects are those with all of them in the model; what is `added` to variances is in
    their uncertainties. What looks like an accepted one is added in its place, beside the others; else each by itself.
    By id, so many beside those accepted at `most`; without a candidate that cannot be fitted.
    """
    out = {}
    accepted, fitted = diagnosis.accepted, diagnosis.fitted
    more = added(fitted[-1]) if accepted else {}
    for name, before, after in zip(accepted, fitted[:-1], fitted[1:], strict=True):
        out[name] = _consequence(name, before, after, fitted[-1].joint, more)

    @cache
    def fit_with(names: tuple[str, ...]) -> FittedSessions:
        return fit_sessions(diagnosis.searched.adding(names)) if names else fitted[0]

    for name in [f.name for f in diagnosis.ranked if f.rank and f.name not in accepted][:most]:
        alike = next((group for group in diagnosis.search.groups if name in group), ())
        beside = tuple(one for one in accepted if one not in alike) if set(alike) & set(accepted) else ()
        try:
            before, after = fit_with(beside), fit_with((*beside, name))
        except ModelError:
            continue
        out[name] = _consequence(name, before, after, after.joint, added(after))
    return out


def before_and_after(diagnosis: Diagnosis, found: Finding, changes: Mapping[str, Consequence]) -> tuple[float, float]:
    """RMS residual without and with a candidate, m: of a full fit where there is one, else of the screening."""
    if found.name in changes:
        return changes[found.name].rms_before, changes[found.name].rms_after
    return rms(Pool(diagnosis.fits[0]).residuals), found.rms_after


def _consequence(
    name: str, before: FittedSessions, after: FittedSessions, final: JointFit, added: Mapping[str, float]
) -> Consequence:
    signal, uncertainty = effect_signal(final, name)
    old, new = Pool(before.joint).residuals, Pool(after.joint).residuals
    return Consequence(
        parameters=tuple(one.with_variance(added) for one in effect_estimates(final, [name])),
        signal=signal if rms(uncertainty) < _MOST_RELATIVE_U * rms(signal) else None,
        rms_before=rms(old),
        rms_after=rms(new),
        map_change_rms=map_change(before.error_map, after.error_map),
        explained=old - new,
    )
