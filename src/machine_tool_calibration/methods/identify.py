"""From a session to the machine's errors: the one entry for nodes, command line and programs."""

from __future__ import annotations

from collections.abc import Sequence

from machine_tool_calibration.diagnosis.outliers import set_aside
from machine_tool_calibration.effects.catalogue import find_effects
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.averaging import averaged_map
from machine_tool_calibration.methods.build import build_model, rejected_readings
from machine_tool_calibration.methods.fitted import fit_sessions
from machine_tool_calibration.methods.impossible_sizes import refuse_impossible
from machine_tool_calibration.model.effect_terms import add_effects
from machine_tool_calibration.model.result import EffectSet, Rejected, Result
from machine_tool_calibration.session.session import Session

__all__ = ["build_model", "identify", "rejected_readings", "sound"]


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
    sets: Sequence[EffectSet] = (),
) -> Result:
    """Identify the machine's errors from one session.

    Args:
        session: the measurement.
        model: the method's variant, such as `free` or `rigid_body`; the method's default if absent.
        effects: ids of physical effects to add to the model.
        own: the user's own effects, beside the catalogue.
        keep_all: use all readings; otherwise those that stand out of all others are set aside.
        allow_impossible: accept position errors and places of stations that no machine has.
        sets: of effects that the readings do not tell apart, over which the map is the mean; `effects` is one of them.

    Raises:
        ModelError: the data does not allow the model, an effect is unknown or needs what was not recorded, or what is
            identified cannot be.
    """
    kept, rejected = (session, rejected_readings(session)) if keep_all else sound(session, model, effects, own)
    fitted = fit_sessions([kept], model=model, effects=effects, own=own)
    fit = fitted.joint.fits[0]
    error_map, averaged = averaged_map(
        fitted.error_map,
        effects,
        sets,
        lambda others: fit_sessions([kept], model=model, effects=others, own=own).error_map,
    )
    refuse_impossible(session, error_map, allow=allow_impossible)
    return Result(
        fit=fit,
        error_map=error_map,
        effects=tuple(effects),
        model_name=fitted.model_names[0],
        rejected=rejected,
        observations=len(session.readings),
        averaged=averaged,
    )
