"""The answer of the probing self-calibration: workpiece, linear axes on their grid, and C at each index."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.machine.tables import MachineTable
from machine_tool_calibration.methods.probing_workpiece import (
    common_motions,
    responses,
    workpiece_errors,
    workpiece_form,
)
from machine_tool_calibration.methods.rigid_body import map_field
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import NotDetermined
from machine_tool_calibration.model.result import ErrorMap

if TYPE_CHECKING:
    from machine_tool_calibration.methods.probing import ProbingModel

__all__ = ["probing_map"]

# Change with an undetermined direction of unit length below which a value does not take part in it.
_LOOSE = 1e-6


def probing_map(model: ProbingModel, fit: Fit) -> ErrorMap:
    """Collect the errors with their standard uncertainties; NaN where the touches do not determine them.

    The content holds, in the order of the session's lists: `workpiece_error`, along the outward normal, in the
    datum (position, direction and form); `workpiece_form`, the same without what a shift and turn of the whole
    workpiece explain; `position_error` of the linear axes on `grid`, X slow and Y fast, (E_X, E_Y) of Eqs. (4)(5);
    `EXC`, `EYC`, `ECC` at the indices `c`. Metres and radians.
    """
    workpiece, lost = _workpiece(model, fit)
    places = np.array([(x, y, 0.0) for x in model.grid[0] for y in model.grid[1]])
    error, covariance = _plane(model.tables, places, fit)
    uncertainty = np.asarray(np.sqrt(np.einsum("nii->ni", covariance)))
    setups = model.description.setups
    content: dict[str, Any] = {
        **workpiece,
        "grid": places[:, :2],
        "position_error": error,
        "position_error_u": uncertainty,
        "setups": [setup.id for setup in setups],
        "c": np.array([setup.c for setup in setups]),
        **_axis_c(fit, [setup.id for setup in setups]),
        "datum": model.datum,
    }
    return ErrorMap(content, places, _with_z(error), _with_z(uncertainty), _with_z_square(covariance), lost)


def _workpiece(model: ProbingModel, fit: Fit) -> tuple[dict[str, Any], tuple[NotDetermined, ...]]:
    """Errors of the workpiece's points, as they are in the datum and without the motion of the whole."""
    points = model.description.workpiece
    found = responses(fit, model.touches.point, len(points))
    errors = workpiece_errors(found)
    form = workpiece_form(found, common_motions(model.description, model.length_known))
    content = {
        "workpiece_points": [point.id for point in points],
        "workpiece_error": errors.value,
        "workpiece_error_u": errors.uncertainty,
        "workpiece_form": form.value,
        "workpiece_form_u": form.uncertainty,
    }
    lost = []
    for k in np.flatnonzero(~np.isfinite(errors.value)):
        why = "it was not touched"
        if found.touched[k]:
            why = "the touches cannot tell it from the error motions of the axes"
        if np.isfinite(form.value[k]):
            why = "the touches do not fix the position and size of the workpiece as a whole; its form is given"
        lost.append(NotDetermined(f"workpiece point {points[k].id}", why))
    return content, tuple(lost)


def _plane(tables: tuple[MachineTable, ...], places: Array, fit: Fit) -> tuple[Array, Array]:
    """Position error (n, 2) of the linear axes at places (n, 3), and its covariance (n, 2, 2)."""
    field = map_field(tables, places)[:, :, :2]
    k, n, _ = field.shape
    flat = field.reshape(k, -1)
    error = (fit.theta[:k] @ flat).reshape(n, 2)
    covariance = np.einsum("knd,kl,lne->nde", field, fit.covariance[:k, :k], field, optimize=True)
    loose = np.linalg.norm(flat.T @ fit.undetermined[:k], axis=1).reshape(n, 2) > _LOOSE
    error[loose] = np.nan
    covariance[loose] = np.nan
    covariance.transpose(0, 2, 1)[loose] = np.nan
    return error, covariance


def _axis_c(fit: Fit, setup_ids: list[str]) -> dict[str, Array]:
    """EXC, EYC and ECC at every index."""
    names = [parameter.name for parameter in fit.model.parameters]
    value = np.where(fit.determined, fit.theta, np.nan)
    uncertainty = np.where(fit.determined, np.sqrt(np.maximum(np.diag(fit.covariance), 0.0)), np.nan)
    out = {}
    for name in ("EXC", "EYC", "ECC"):
        pick = [names.index(f"{name}({setup_id})") for setup_id in setup_ids]
        out[name], out[f"{name}_u"] = value[pick], uncertainty[pick]
    return out


def _with_z(values: Array) -> Array:
    out = np.full((len(values), 3), np.nan)
    out[:, :2] = values
    return out


def _with_z_square(values: Array) -> Array:
    out = np.full((len(values), 3, 3), np.nan)
    out[:, :2, :2] = values
    return out
