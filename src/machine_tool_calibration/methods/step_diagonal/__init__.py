"""Laser step diagonal: a linear interferometer on a flat mirror, diagonals as sequences of single-axis moves.

Ibaraki and Hata 2010, A new formulation of laser step diagonal measurement, Precision Engineering 34(3).
"""

from machine_tool_calibration.methods.step_diagonal.build import MODELS, build
from machine_tool_calibration.methods.step_diagonal.compare import (
    FORMULATIONS,
    Comparison,
    compare_formulations,
    identify_by_formulation,
)
from machine_tool_calibration.methods.step_diagonal.model import StepDiagonalModel
from machine_tool_calibration.methods.step_diagonal.profiles import Figure, Profiles

__all__ = [
    "FORMULATIONS",
    "MODELS",
    "Comparison",
    "Figure",
    "Profiles",
    "StepDiagonalModel",
    "build",
    "compare_formulations",
    "identify_by_formulation",
]
