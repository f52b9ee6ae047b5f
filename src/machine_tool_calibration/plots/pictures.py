# SPDX-License-Identifier: Apache-2.0
"""The pictures of a result, whatever the method."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.plots.direct import standard_figures
from machine_tool_calibration.plots.error_map import draw_map, draw_tables
from machine_tool_calibration.plots.style import save
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.method import load
from machine_tool_calibration.session.provenance import Provenance
from machine_tool_calibration.session.session import Session

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["common_figures", "draw", "draw_common", "figures"]


def draw(session: Session, result: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the pictures of a result document into a folder.

    A method without pictures of its own gets those of its map and of its tables of error motions.

    Returns:
        The files.
    """
    return save(figures(session, result), folder, Provenance.read(result["provenance"]))


def figures(session: Session, result: Mapping[str, Any]) -> dict[str, Figure]:
    """The same pictures by name, not written."""
    own = spec_of(session).pictures
    return common_figures(result) if own is None else dict(load(own).figures(session, result))


def draw_common(result: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the map and the tables of error motions of any result, also of several sessions together."""
    return save(common_figures(result), folder, Provenance.read(result["provenance"]))


def common_figures(result: Mapping[str, Any]) -> dict[str, Figure]:
    """The map and the tables of error motions of any result, where there are any."""
    content = result.get("error_map") or {}
    mapped = content.get("points") and content.get("position_error")
    drawn = {
        "error_map": draw_map(content) if mapped else None,
        "error_motions": draw_tables(result.get("parameters", ())),
    }
    return {name: figure for name, figure in drawn.items() if figure is not None} | standard_figures(content)
