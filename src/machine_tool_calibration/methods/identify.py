"""From a session to the machine's errors: the one entry for nodes, command line and programs."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Protocol, cast

import numpy as np

from machine_tool_calibration.diagnosis.outliers import set_aside
from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.impossible_sizes import refuse_impossible
from machine_tool_calibration.model.effect_terms import add_effects
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.model.result import Rejected, Result
from machine_tool_calibration.session.session import Session

__all__ = ["build_model", "identify", "rejected_readings", "sound"]

_MODULES = {
    "tracking_interferometer": "tracking",
    "step_diagonal": "step_diagonal",
    "probing": "probing",
    "rotary_axis": "rotary_axis",
    "direct": "direct",
}


class _Method(Protocol):
    """What the module of a method offers; the first of its models is the default."""

    MODELS: tuple[str, ...]

    def build(self, session: Session, model: str) -> MethodModel:
        """The model of a session."""


def build_model(session: Session, model: str | None = None) -> tuple[MethodModel, str]:
    """The model of a session, without added effects, and its name.

    Raises:
        ModelError: no such model for this method, or the data does not allow it.
    """
    method = cast(_Method, import_module(f"machine_tool_calibration.methods.{_MODULES[session.method]}"))
    name = model or method.MODELS[0]
    if name not in method.MODELS:
        raise ModelError(f"{session.method} has no model {name!r}; known are {', '.join(method.MODELS)}")
    return method.build(session, name), name


def rejected_readings(session: Session) -> tuple[Rejected, ...]:
    """Readings that no fit uses."""
    missing = np.flatnonzero(~np.isfinite(session.readings.displacement))
    return tuple(Rejected(int(session.readings.row[k]), "the reading is missing") for k in missing)


def sound(
    session: Session, model: str | None, effects: Sequence[str] = (), own: Sequence[Effect] = ()
) -> tuple[Session, tuple[Rejected, ...]]:
    """The session with its gross errors as lost readings, and all readings that no fit uses.

    Args:
        session: the measurement.
        model: the method's variant.
        effects: ids of effects in the model.
        own: the user's own effects.
    """
    present = find_effects(effects, own)
    found, kept = set_aside(session, lambda part: add_effects(build_model(part, model)[0], present))
    return kept, rejected_readings(session) + tuple(Rejected(o.row, o.reason) for o in found)


@single_blas()
def identify(
    session: Session,
    *,
    model: str | None = None,
    effects: Sequence[str] = (),
    own: Sequence[Effect] = (),
    keep_all: bool = False,
    allow_impossible: bool = False,
) -> Result:
    """Identify the machine's errors from one session.

    Args:
        session: the measurement.
        model: the method's variant, such as `free` or `rigid_body`; the method's default if absent.
        effects: ids of physical effects to add to the model.
        own: the user's own effects, beside the catalogue.
        keep_all: use all readings; otherwise those that stand out of all others are set aside.
        allow_impossible: accept position errors and places of stations that no machine has.

    Raises:
        ModelError: the data does not allow the model, an effect is unknown or needs what was not recorded, or what is
            identified cannot be.
    """
    kept, rejected = (session, rejected_readings(session)) if keep_all else sound(session, model, effects, own)
    base, name = build_model(kept, model)
    built = add_effects(base, find_effects(effects, own))
    fit = fit_models([built]).fits[0]
    error_map = built.error_map(fit)
    refuse_impossible(session, error_map, allow=allow_impossible)
    return Result(
        fit=fit,
        error_map=error_map,
        effects=tuple(effects),
        model_name=name,
        rejected=rejected,
        observations=len(session.readings),
    )
