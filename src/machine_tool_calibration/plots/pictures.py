"""The pictures of a result, whatever the method."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, cast

from machine_tool_calibration.session.session import Session

__all__ = ["draw"]


def draw(session: Session, result: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the pictures of a result document into a folder; none for a method that has none.

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
        return []
    method = cast("Callable[[Session, Mapping[str, Any], Path], list[Path]] | None", getattr(module, "draw", None))
    return method(session, result, folder) if method is not None else []
