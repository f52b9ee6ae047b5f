"""The figures of a result, in words and micrometres."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

__all__ = ["figures"]

# Chance of the residuals below which the model is in doubt.
_DOUBTFUL = 0.01
_PUBLISHED = ("x", "y", "z", "workpiece_error", "workpiece_form")
_MOTION = re.compile(r"E[XYZABC][XYZABC]")


def figures(document: dict[str, Any]) -> list[tuple[str, str]]:
    """What the result of a session says, in words and micrometres."""
    rows = [
        ("readings used", f"{document['used']} of {document['observations']}"),
        ("RMS residual", f"{document['rms_residual'] * 1e6:.3f} µm"),
    ]
    chi = document.get("reduced_chi_square")
    if chi is not None:
        rows.append(("reduced chi-square", f"{chi:.2f} (1 if the model and the declared uncertainty are right)"))
    error_map = document.get("error_map") or {}
    error, uncertainty = _array(error_map.get("position_error")), _array(error_map.get("position_error_u"))
    if error.size:
        rows.append(("points of the map", _points(error_map.get("points"), len(error))))
        known = np.isfinite(error).any()
        text = f"{_rms(error):.2f} µm RMS, {_largest(error):.2f} µm at most" if known else "not determined"
        rows.append(("error of position", text + (_lost(error) if known else "")))
    if np.isfinite(uncertainty).any():
        rows.append(
            (
                "its uncertainty U (k = 2)",
                f"{2 * _rms(uncertainty):.2f} µm RMS, {2 * _largest(uncertainty):.2f} µm at most{_if_right(document)}",
            )
        )
    rows += _motions(error_map)
    missing = document.get("not_determined") or []
    if missing:
        names = ", ".join(entry["name"] for entry in missing[:6])
        rows.append(("not determined", f"{names}{' …' if len(missing) > 6 else ''}"))
    return rows


def _lost(error: np.ndarray) -> str:
    """Directions in which no point has a value."""
    lost = [axis for axis, known in zip("xyz", np.isfinite(error).any(axis=0), strict=False) if not known]
    return f"; not determined along {', '.join(lost)}" if lost else ""


def _points(points: Any, count: int) -> str:
    """How many, and why one place may be there more than once."""
    places = len({tuple(point) for point in points}) if points else count
    if places == count:
        return str(count)
    return f"{count}, at {places} places: a place counts once for each direction of approach that an effect tells apart"


def _motions(content: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Largest value and uncertainty of what a map holds beside positions."""
    out = []
    for name, value in content.items():
        known = name in _PUBLISHED or _MOTION.fullmatch(name)
        if not known or f"{name}_u" not in content or not isinstance(value, list):
            continue
        found, u = (np.array(content[key], dtype=float).reshape(-1) for key in (name, f"{name}_u"))
        good = np.isfinite(found)
        title = f"errors of {name.upper()}" if name in ("x", "y", "z") else name.replace("_", " ")
        if not good.any():
            out.append((title, "not determined"))
            continue
        unit = "µrad" if _MOTION.fullmatch(name) and name[1] in "ABC" else "µm"
        text = (
            f"{1e6 * np.abs(found[good]).max():.2f} {unit} at most, U (k = 2) at most {2e6 * u[good].max():.2f} {unit}"
        )
        out.append((title, text + ("" if good.all() else f"; {int((~good).sum())} of {len(good)} not determined")))
    return out


def _if_right(document: dict[str, Any]) -> str:
    """A warning where the readings speak against the model on which the uncertainty rests."""
    p = document.get("p_value")
    return ", if the model were right" if p is not None and p < _DOUBTFUL else ""


def _array(value: Any) -> np.ndarray:
    return np.array(value, dtype=float) if value else np.zeros((0, 3))


def _rms(vectors: np.ndarray) -> float:
    """Root mean square length of the vectors of which anything is known, micrometres."""
    known = vectors[np.isfinite(vectors).any(axis=1)]
    return float(np.sqrt(np.mean(np.nansum(known**2, axis=1)))) * 1e6


def _largest(vectors: np.ndarray) -> float:
    """Greatest length of a vector, micrometres."""
    return float(np.sqrt(np.max(np.nansum(vectors**2, axis=1)))) * 1e6
