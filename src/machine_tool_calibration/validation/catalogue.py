# SPDX-License-Identifier: Apache-2.0
"""The papers that are done anew, by the method that each describes."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pkgutil import iter_modules

from machine_tool_calibration import validation
from machine_tool_calibration.errors import CalibrationError, did_you_mean
from machine_tool_calibration.validation.record import Study

__all__ = ["study", "study_names"]

_FIRST = "study_"


def study_names() -> list[str]:
    """Names of all studies: those of the modules `study_NAME`."""
    return sorted(m.name.removeprefix(_FIRST) for m in iter_modules(validation.__path__) if m.name.startswith(_FIRST))


def study(name: str, progress: Callable[[str, float], None] = lambda what, share: None) -> Study:
    """Do a paper's calculations and simulations anew.

    Args:
        name: of the study.
        progress: called with what is being done and the share that is finished.

    Raises:
        CalibrationError: there is no such study.
    """
    names = study_names()
    if name not in names:
        raise CalibrationError(f"no study {name!r}{did_you_mean(name, names)}; there are {', '.join(names)}")
    made: Study = import_module(f"{validation.__name__}.{_FIRST}{name}").study(progress)
    return made
