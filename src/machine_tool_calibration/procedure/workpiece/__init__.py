# SPDX-License-Identifier: Apache-2.0
"""Workpieces for probing: from a drawing-like description, a CSV or a DXF outline to points with normals."""
