# SPDX-License-Identifier: Apache-2.0
"""A list of which points of a workpiece make a feature, where the session's points do not name it.

::

    format: mtcal-feature-points/1
    features:
      pin1: [0, 1, 2, 3]
      wall: [p7, p8, p9]
"""

from __future__ import annotations

from pathlib import Path

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.text import read_text
from machine_tool_calibration.session.yaml_text import load_yaml

__all__ = ["read_feature_points"]

_FORMAT = "mtcal-feature-points/1"
_KEYS = {"format", "features"}


def read_feature_points(file: Path) -> dict[str, tuple[str, ...]]:
    """Ids of the points of each feature.

    Raises:
        SessionError: one line with file, line and key of the first defect.
    """
    document = load_yaml(read_text(file), str(file), truth=False)
    value = document.value
    if not isinstance(value, dict) or value.get("format") != _FORMAT:
        raise SessionError(f"{file}: no list of features: the key format must be {_FORMAT}")
    if unknown := sorted(set(value) - _KEYS):
        raise SessionError(f"{file} line {document.line((unknown[0],))}: unknown key {unknown[0]!r}")
    listed = value.get("features")
    if not isinstance(listed, dict) or not listed:
        raise SessionError(f"{file}: features must be a mapping of names to lists of points")
    for name, points in listed.items():
        if not isinstance(points, list) or not points or not all(isinstance(p, str | int) for p in points):
            where = f"{file} line {document.line(('features', name))}"
            raise SessionError(f"{where}: features.{name} must be a list of ids of points")
    return {name: tuple(str(point) for point in points) for name, points in listed.items()}
