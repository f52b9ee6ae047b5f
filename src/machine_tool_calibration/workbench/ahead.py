# SPDX-License-Identifier: Apache-2.0
"""What further measurements and procedures would tell, as the page asks for it."""

from __future__ import annotations

from machine_tool_calibration.interface.show import printed
from machine_tool_calibration.planning.forecast import forecast
from machine_tool_calibration.planning.outlook import Outlook, current, outlook_of, outlooks
from machine_tool_calibration.procedure import Procedure
from machine_tool_calibration.reports.forecast import show_forecast
from machine_tool_calibration.workbench.models import Model, Progress, Subject

__all__ = ["looked_ahead", "planned"]


def looked_ahead(subject: Subject, model: Model, progress: Progress) -> list[Outlook]:
    """What is known with a model, and what would be after each further measurement."""
    return outlooks(subject.chosen(model), progress)


def planned(
    subject: Subject,
    model: Model | None,
    procedure: Procedure,
    variant: str | None,
    warming: float,
    angular: float,
    progress: Progress,
) -> tuple[Outlook | None, Outlook, str]:
    """What a procedure would tell by itself, and that in the words of `mtcal plan`.

    Args:
        subject: for the user's own effects.
        model: of which to say what is known now as well; None if that is known.
        procedure: what would be measured.
        variant: of its method's model.
        warming: of the air, K per hour.
        angular: errors of the machine that are assumed, rad.
        progress: told what is being done.
    """
    found = forecast(procedure, model=variant, own=subject.own, warming=warming, angular=angular, progress=progress)
    now = None if model is None else current(subject.chosen(model))
    words = f"procedure {procedure.name}, by itself"
    return now, outlook_of(found, words), printed(lambda screen: show_forecast(screen, found))
