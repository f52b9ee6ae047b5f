# SPDX-License-Identifier: Apache-2.0
"""Calibration of machine tools: geometric errors from displacement readings.

What people need in a notebook is here; everything else is in the folders of the package::

    import machine_tool_calibration as mtcal

    session = mtcal.load("session")
    fit = mtcal.identify(session)
    better = fit.add(fit.diagnose().effects)

Nothing is imported before it is asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from machine_tool_calibration.version import __version__

if TYPE_CHECKING:
    from machine_tool_calibration.errors import CalibrationError
    from machine_tool_calibration.interface.budget import Budget, Conformity
    from machine_tool_calibration.interface.diagnosis import Comparison, Diagnosis
    from machine_tool_calibration.interface.effects import Effect, catalogue
    from machine_tool_calibration.interface.features import Features
    from machine_tool_calibration.interface.identification import Fit, identify
    from machine_tool_calibration.interface.improvement import Improvement, improve, plot_improvement
    from machine_tool_calibration.interface.map_comparison import MapComparison
    from machine_tool_calibration.interface.session import Measurement, load, simulate


__all__ = [
    "Budget", "CalibrationError", "Comparison", "Conformity", "Diagnosis", "Effect", "Features", "Fit",
    "Improvement", "MapComparison", "Measurement", "__version__", "catalogue", "identify", "improve",
    "load", "plot_improvement", "simulate",
]  # fmt: skip

if not TYPE_CHECKING:
    # Where each name is; a type checker reads the imports above instead.
    _NAMES = {
        "errors": ("CalibrationError",),
        "interface.budget": ("Budget", "Conformity"),
        "interface.diagnosis": ("Comparison", "Diagnosis"),
        "interface.effects": ("Effect", "catalogue"),
        "interface.features": ("Features",),
        "interface.identification": ("Fit", "identify"),
        "interface.improvement": ("Improvement", "improve", "plot_improvement"),
        "interface.map_comparison": ("MapComparison",),
        "interface.session": ("Measurement", "load", "simulate"),
    }
    _HOME = {name: home for home, names in _NAMES.items() for name in names}

    def __getattr__(name):
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        value = globals()[name] = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
        return value

    def __dir__():
        return sorted({*globals(), *__all__})
