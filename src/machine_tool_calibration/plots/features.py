# SPDX-License-Identifier: Apache-2.0
"""Picture of a probed part's features: deviations magnified, with ellipses of uncertainty (the paper's Fig. 17)."""

from collections.abc import Mapping

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.coverage import K
from machine_tool_calibration.methods.probing.features import Features
from machine_tool_calibration.methods.probing.geometry import Circle, Line
from machine_tool_calibration.plots import style
from machine_tool_calibration.plots.style import Axes, Figure
from machine_tool_calibration.words import say

_LENGTH = 0.16  # share of the drawing's width that the largest deviation takes
# Semi-axes of an ellipse that holds a pair of normal quantities with 95 %, in standard uncertainties.
_ELLIPSE = float(np.sqrt(-2.0 * np.log(0.05)))
_ROUND = np.linspace(0.0, 2.0 * np.pi, 73)


def draw_features(found: Features, title: str = "", beside: Mapping[str, Array] | None = None) -> Figure:
    """Centres and walls where they are, deviations magnified, under a title or the frame in words.

    With further deviations (q,) of the same quantities `beside` them, by what they are, shown at the centres.
    """
    place = {(q.of[0], q.what): k for k, q in enumerate(found.quantities) if len(q.of) == 1}
    centres = [one for one in found.elements if isinstance(one, Circle)]
    walls = [one for one in found.elements if isinstance(one, Line)]
    indices = [[place[one.name, "x"], place[one.name, "y"]] for one in centres]
    indices += [[place[one.name, "offset"], place[one.name, "direction"]] for one in walls]
    ends = [_ends(found, one, index) for one, index in zip(walls, indices[len(centres) :], strict=True)]
    sizes = [np.linalg.norm(found.deviation[index]) + K * found.uncertainty[index].max() for index in indices]
    sizes[len(centres) :] = [float(np.abs(off).max() + K * u.max()) for _, off, u in ends]
    for values in (beside or {}).values():
        sizes += [float(np.linalg.norm(values[index])) for index in indices[: len(centres)]]
    largest = float(np.nanmax(sizes, initial=0.0)) if np.isfinite(sizes).any() else 0.0
    corners = np.array([one.place for one in centres] + [end for places, _, _ in ends for end in places])
    extent = float(np.ptp(corners, axis=0).max()) if len(corners) > 1 else 0.0
    extent = extent or 2 * max((one.radius for one in centres), default=0.5)
    scale = style.magnification(largest, extent, _LENGTH)
    figure = style.new_figure(8.5, 8.5, title or say("picture.features", datum=found.datum))
    panel = figure.subplots()
    for one, index in zip(centres, indices, strict=False):
        _draw_centre(panel, one, found, index, scale)
    for wall, (places, off, u) in zip(walls, ends, strict=True):
        _draw_wall(panel, wall, places, off, u, scale)
    for (what, values), color in zip((beside or {}).items(), style.COLORS[1:], strict=False):
        for one, index in zip(centres, indices, strict=False):
            ends_at = np.array([one.place, one.place + scale * values[index]])
            panel.plot(*(1e3 * ends_at.T), ls="-", lw=1.0, color=color)
            panel.plot(*(1e3 * ends_at[1]), marker="o", ms=3, mfc="none", color=color)
        panel.plot([], [], ls="-", marker="o", ms=3, mfc="none", lw=1.0, color=color, label=what)
    panel.plot([], [], "+", color=style.NOMINAL, label=say("picture.nominal"))
    magnified = say("picture.identified_scale", scale=style.spaced(scale))
    panel.plot([], [], "o-", ms=2, lw=1, color=style.FOUND, label=magnified)
    panel.plot([], [], color=style.BAND, label=say("picture.ellipse"))
    panel.set_aspect("equal")
    style.name_axes(panel, 0, 1)
    box = panel.dataLim
    style.scale_bar(panel, scale, largest, np.array([box.x0, box.y0]), np.array([box.x1, box.y1]))
    panel.margins(0.08)
    panel.legend(loc="upper right", fontsize="small")
    return figure


def _ends(found: Features, wall: Line, index: list[int]) -> tuple[Array, Array, Array]:
    """The nominal ends of a wall (2, 2), how far each is off along the normal (2,), and its standard uncertainty."""
    t = np.array([-wall.reach, wall.reach])
    design = np.column_stack([np.ones(2), t])
    covariance = design @ found.uncertainty_matrix[np.ix_(index, index)] @ design.T
    places = wall.place + t[:, None] * wall.along
    return places, design @ found.deviation[index], np.sqrt(np.maximum(np.diag(covariance), 0.0))


def _draw_centre(panel: Axes, one: Circle, found: Features, index: list[int], scale: float) -> None:
    nominal, deviation = 1e3 * one.place, found.deviation[index]
    panel.plot(*nominal, "+", color=style.NOMINAL, ms=9)
    outline = nominal[:, None] + 1e3 * one.radius * np.array([np.cos(_ROUND), np.sin(_ROUND)])
    panel.plot(*outline, color=style.NOMINAL, lw=0.7)
    if not np.all(np.isfinite(deviation)):
        panel.plot(*nominal, "x", color="black")
        _label(panel, say("picture.name_lost", name=one.name), nominal)
        return
    moved = nominal + 1e3 * scale * deviation
    values, vectors = np.linalg.eigh(found.uncertainty_matrix[np.ix_(index, index)])
    axes = vectors * np.sqrt(np.maximum(values, 0.0)) * _ELLIPSE
    ring = moved[:, None] + 1e3 * scale * axes @ np.array([np.cos(_ROUND), np.sin(_ROUND)])
    panel.plot(*ring, color=style.BAND, lw=1.0)
    panel.plot(*np.column_stack([nominal, moved]), color=style.FOUND, lw=1.0)
    panel.plot(*moved, "o", color=style.FOUND, ms=2)
    _label(panel, one.name, nominal)


def _draw_wall(panel: Axes, one: Line, places: Array, off: Array, u: Array, scale: float) -> None:
    panel.plot(*(1e3 * places.T), color=style.NOMINAL, lw=1.2)
    _label(panel, one.name, 1e3 * one.place)
    if not np.all(np.isfinite(off)):
        panel.plot(*(1e3 * one.place), "x", color="black")
        return
    for sign, color in ((-2.0, style.BAND), (2.0, style.BAND), (0.0, style.FOUND)):
        drawn = places + scale * (off + sign * u)[:, None] * one.normal
        panel.plot(*(1e3 * drawn.T), color=color, lw=1.0)


def _label(panel: Axes, text: str, place: Array) -> None:
    at = (float(place[0]), float(place[1]))
    panel.annotate(text, at, (6, -11), textcoords="offset points", fontsize="x-small", color="0.35")
