"""A model made better as a document for programs."""

from __future__ import annotations

from typing import Any

from machine_tool_calibration.diagnosis.improve import Improvement

__all__ = ["improvement_document"]


def improvement_document(done: Improvement) -> dict[str, Any]:
    """The content of `mtcal-improvement/1`: every model on the way, and the result document of the last.

    SI units. The set-aside readings are rows from 0; what is not finite is yet to be made null, as `plain` does.
    """
    return {
        "format": "mtcal-improvement/1",
        "verdict": done.diagnosis.verdict,
        "accepted": done.diagnosis.accepted,
        "set_aside": done.steps[-1].set_aside,
        "steps": [
            {
                "change": step.change,
                "effects": step.result.effects,
                "readings": step.result.joint.assembly.problem.n_readings,
                "rms_residual": step.result.rms_residual,
                "reduced_chi_square": step.reduced_chi_square,
                "p_value": step.result.joint.p_value,
                "map_rms": step.map_rms,
                "map_change_rms": step.map_change,
                "map_uncertainty_rms": step.map_uncertainty,
                "left_at_tool_rms": step.left_at_tool,
                "parameters": [estimate.document() for estimate in step.parameters],
            }
            for step in done.steps
        ],
        "result": done.steps[-1].result.document(),
    }
