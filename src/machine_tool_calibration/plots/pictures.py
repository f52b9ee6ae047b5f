"""The pictures of a result, whatever the method."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, cast

from machine_tool_calibration.plots.error_map import draw_map
from machine_tool_calibration.plots.tables import draw_tables
from machine_tool_calibration.session.session import Session

__all__ = ["draw", "draw_common"]


def draw(session: Session, result: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the pictures of a result document into a folder.

    A method without pictures of its own gets those of its map and of its tables of error motions.

    Args:
        session: the measurement.
        result: the document of an identification.
        folder: where the files go.

    Returns:
        The files.
    """
    name = "tracking" if session.method == "tracking_interferometer" else session.method
    try:
        module = import_module(f"machine_tool_calibration.plots.{name}")
    except ModuleNotFoundError:
        return draw_common(result, folder)
    method = cast("Callable[[Session, Mapping[str, Any], Path], list[Path]] | None", getattr(module, "draw", None))
    return draw_common(result, folder) if method is None else method(session, result, folder)


def draw_common(result: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the map and the tables of error motions of any result, also of several sessions together."""
    content = result.get("error_map") or {}
    mapped = content.get("points") and content.get("position_error")
    figures = {
        "error_map.png": draw_map(content) if mapped else None,
        "error_motions.png": draw_tables(result.get("parameters", ())),
    }
    written = []
    for name, figure in figures.items():
        if figure is not None:
            figure.savefig(folder / name, dpi=110)
            written.append(folder / name)
    return written
