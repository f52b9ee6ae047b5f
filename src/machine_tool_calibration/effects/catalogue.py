"""The physical effects that may be added to a model."""

from __future__ import annotations

from collections.abc import Sequence

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.model.model import MethodModel
from machine_tool_calibration.model.terms import Term

__all__ = ["effect_terms"]


def effect_terms(model: MethodModel, effects: Sequence[str]) -> list[Term]:
    """The terms of effects, for a model's readings.

    Raises:
        ModelError: an unknown effect, or one that needs what was not recorded.
    """
    if effects:
        raise ModelError(f"unknown effect {effects[0]!r}")
    return []
