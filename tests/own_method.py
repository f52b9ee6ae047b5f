# SPDX-License-Identifier: Apache-2.0
"""An installed package that announces a method of its own."""

from pathlib import Path

from machine_tool_calibration.session import catalogue


def announced(site: Path, line: str) -> Path:
    """A folder with an installed package that announces a method."""
    info = site / "circle_gauge-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Name: circle-gauge\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{catalogue.ENTRY_POINT_GROUP}]\n{line}\n")
    return site


def forget() -> None:
    """The next who asks looks for installed methods again."""
    catalogue._plugins.cache_clear()
    catalogue.method_spec.cache_clear()
