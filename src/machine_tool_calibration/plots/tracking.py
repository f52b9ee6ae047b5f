"""The map of a tracking interferometer: targets where they were found, errors magnified, as in paper 003's Fig. 10."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.session.session import Session

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw", "draw_map"]

_NOMINAL, _FOUND, _BAND = "0.7", "#0072b2", "#e69f00"
# Largest error as a share of the smallest distance between neighbours.
_SHARE = 0.6


def draw(session: Session, result: Mapping[str, Any], folder: Path) -> list[Path]:
    """Write the picture of a result document into a folder.

    Returns:
        The file.
    """
    file = folder / "error_map.png"
    draw_map(result["error_map"]).savefig(file, dpi=110)
    return [file]


def draw_map(content: Mapping[str, Any], title: str = "") -> Figure:
    """Commanded and found positions, with ellipses of expanded uncertainty (k = 2); three views of a volume.

    Args:
        content: the error map of a result, as in its document or with arrays.
        title: above the picture.
    """
    from matplotlib.figure import Figure

    points = np.array(content["points"], dtype=float)
    error = np.array(content["position_error"], dtype=float)
    uncertainty = np.array(content["position_error_u"], dtype=float)
    views = [(0, 1)] if error.shape[1] == 2 else [(0, 1), (0, 2), (1, 2)]
    figure = Figure(figsize=(7.5 if len(views) == 1 else 16.5, 7.2 if len(views) == 1 else 6.2), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(views)))
    scale = _magnification(points[:, : error.shape[1]], error)
    for panel, axes in zip(panels, views, strict=True):
        _view(panel, points, error, uncertainty, axes, scale)
    largest = float(np.nanmax(np.linalg.norm(error, axis=1)))
    text = title or "Targets as found, errors magnified"
    times = f"{scale:,.0f}".replace(",", " ")
    figure.suptitle(f"{text} {times} times; largest error {largest * 1e6:.1f} µm", fontsize="medium")
    return figure


def _view(panel: Axes, points: Array, error: Array, uncertainty: Array, axes: tuple[int, int], scale: float) -> None:
    """One projection; in a volume all layers lie on each other."""
    from matplotlib.collections import EllipseCollection

    a, b = axes
    nominal = points[:, [a, b]] * 1e3
    found = nominal + scale * error[:, [a, b]] * 1e3
    good = np.isfinite(found).all(axis=1)
    for lines, style in (
        (nominal, {"color": _NOMINAL, "lw": 0.8}),
        (found, {"color": _FOUND, "lw": 0.6, "alpha": 0.7}),
    ):
        for k, m in _neighbours(points, axes):
            panel.plot(lines[[k, m], 0], lines[[k, m], 1], zorder=1, **style)  # type: ignore[arg-type]
    larger = _larger(nominal, scale * uncertainty[:, [a, b]] * 1e3)
    size = 4 * larger * scale * uncertainty[:, [a, b]] * 1e3
    ellipses = EllipseCollection(
        size[good, 0], size[good, 1], np.zeros(int(good.sum())), units="xy", offsets=found[good],
        offset_transform=panel.transData, facecolor="none", edgecolor=_BAND, lw=0.9, zorder=2,
    )  # fmt: skip
    panel.add_collection(ellipses)
    panel.plot(nominal[:, 0], nominal[:, 1], ".", color=_NOMINAL, ms=4, label="commanded", zorder=2)
    panel.plot(found[good, 0], found[good, 1], "o", color=_FOUND, ms=2.5, label="found", zorder=3)
    panel.plot(
        [], [], "o", mfc="none", mec=_BAND, label="U (k = 2)" + (f", {larger:g} times larger" if larger > 1 else "")
    )
    bar = _round(0.4 * float(np.nanmax(np.abs(error))) * 2.5)
    panel.set_aspect("equal")
    panel.margins(0.1)
    panel.set_xlabel(f"{'xyz'[a]}, mm")
    panel.set_ylabel(f"{'xyz'[b]}, mm")
    low_x, low_y = np.nanmin(np.vstack([nominal, found[good]]), axis=0)
    drop = 0.12 * float(np.ptp(nominal[:, 1]) or 1.0)
    panel.plot([low_x, low_x + scale * bar * 1e3], [low_y - drop] * 2, color="black", lw=2)
    panel.annotate(
        f"{bar * 1e6:g} µm", (low_x + scale * bar * 1e3, low_y - drop), (4, 0), textcoords="offset points", va="center"
    )
    panel.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize="small", frameon=False)


def _larger(nominal: Array, uncertainty: Array) -> float:
    """How much larger than the errors the ellipses must be drawn to be seen beside their points."""
    typical = float(np.nanmedian(2 * uncertainty))
    seen = 0.012 * float(np.ptp(nominal, axis=0).max() or 1.0)
    return 1.0 if not typical > 0 or typical >= seen else max(_round(2.0 * seen / typical), 1.0)


def _neighbours(points: Array, axes: tuple[int, int]) -> list[tuple[int, int]]:
    """Pairs of points next to each other along one of the view's axes, all else equal."""
    keys = np.round(points, 7)
    pairs = []
    for axis in axes:
        others = [j for j in range(3) if j != axis]
        order = np.lexsort((keys[:, axis], keys[:, others[0]], keys[:, others[1]]))
        same = (keys[order[1:]][:, others] == keys[order[:-1]][:, others]).all(axis=1)
        pairs += [(int(k), int(m)) for k, m, s in zip(order[:-1], order[1:], same, strict=True) if s]
    return pairs


def _magnification(points: Array, error: Array) -> float:
    """Round number that makes the largest error a good part of the distance between neighbours."""
    steps = [np.diff(np.unique(np.round(points[:, j], 7))) for j in range(points.shape[1])]
    smallest = min((float(s.min()) for s in steps if len(s)), default=0.1)
    return _round(_SHARE * smallest / max(float(np.nanmax(np.abs(error))), 1e-12))


def _round(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten below a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(m for m in (1, 2, 5) if m * power <= value * (1 + 1e-9)) * power)
