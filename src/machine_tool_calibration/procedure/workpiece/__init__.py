# SPDX-License-Identifier: Apache-2.0
"""Workpieces for probing: from a drawing-like description, a CSV or a DXF outline to points with normals."""

from machine_tool_calibration.procedure.workpiece.description import (
    Workpiece,
    read_workpiece,
    workpiece_entries,
    workpiece_points,
)

__all__ = ["Workpiece", "read_workpiece", "workpiece_entries", "workpiece_points"]
