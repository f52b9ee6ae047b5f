"""From a session to the machine's errors: the one entry for nodes, command line and programs."""

from __future__ import annotations

from collections.abc import Sequence

from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.build import build_model, rejected_readings
from machine_tool_calibration.methods.fitted import fit_sessions
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.session.session import Session

__all__ = ["build_model", "identify", "rejected_readings"]


@single_blas()
def identify(
    session: Session, *, model: str | None = None, effects: Sequence[str] = (), own: Sequence[Effect] = ()
) -> Result:
    """Identify the machine's errors from one session.

    Args:
        session: the measurement.
        model: the method's variant, such as `free` or `rigid_body`; the method's default if absent.
        effects: ids of physical effects to add to the model.
        own: the user's own effects, beside the catalogue.

    Raises:
        ModelError: the data does not allow the model, or an effect is unknown or needs what was not recorded.
    """
    fitted = fit_sessions([session], model=model, effects=effects, own=own)
    fit = fitted.joint.fits[0]
    return Result(
        fit=fit,
        error_map=fit.model.error_map(fit),
        effects=tuple(effects),
        model_name=fitted.model_names[0],
        rejected=rejected_readings(session),
        observations=len(session.readings),
    )
