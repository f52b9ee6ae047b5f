# SPDX-License-Identifier: Apache-2.0
"""A map of position errors: measured against nominal places, errors magnified, as in the papers' figures."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.coverage import K
from machine_tool_calibration.machine.error_motions import SQUARENESS
from machine_tool_calibration.plots import style
from machine_tool_calibration.plots.style import Axes, Figure
from machine_tool_calibration.reports.quantities import as_exact, quantity
from machine_tool_calibration.words import say, together


def read_tables(parameters: Iterable[Mapping[str, Any]]) -> dict[str, Array]:
    """Tables among the parameters of a result's document, by name of the error motion.

    (k, 3): position, value and standard uncertainty, in the order of the position.
    """
    rows: dict[str, list[tuple[float, float, float]]] = {}
    for entry in parameters:
        if "error_motion" in entry:
            row = (float(entry["position"]), float(entry["value"]), float(entry["standard_uncertainty"]))
            rows.setdefault(entry["error_motion"], []).append(row)
    return {name: np.array(sorted(entries)) for name, entries in rows.items()}


def draw_tables(parameters: Iterable[Mapping[str, Any]]) -> Figure | None:
    """The error motions among the parameters of a result's document; None where there are none."""
    entries = list(parameters)
    tables = read_tables(entries)
    single = {e["name"]: (e["value"], e["standard_uncertainty"]) for e in entries if e["name"] in SQUARENESS}
    return draw_motions(tables, dict(sorted(single.items()))) if tables else None


def draw_motions(tables: Mapping[str, Array], squareness: Mapping[str, tuple[float, float]]) -> Figure:
    """One row of panels for each axis, of tables by `read_tables`: positioning, straightness, angles; with U (95 %).

    The squareness by name, with its standard uncertainty, rad, is in the title.
    """
    axes = [axis for axis in "XYZABC" if any(name[2] == axis for name in tables)]
    kinds = sorted(set(map(_kind, tables)))
    figure = style.new_figure(4.6 * len(kinds), 3.0 * len(axes) + 0.7, _headed(squareness))
    for row, axis in zip(figure.subplots(len(axes), len(kinds), squeeze=False), axes, strict=True):
        for panel, kind in zip(row, kinds, strict=True):
            _panel(panel, axis, {n: t for n, t in tables.items() if n[2] == axis and _kind(n) == kind})
    return figure


def _kind(name: str) -> int:
    """Whether an error motion is positioning (0), straightness (1) or an angle (2)."""
    return 2 if name[1] in "ABC" else int(name[1] != name[2])


def _panel(panel: Axes, axis: str, tables: Mapping[str, Array]) -> None:
    if not tables:
        panel.set_axis_off()
        return
    rotary = axis in "ABC"
    factor, unit = (180 / np.pi, "°") if rotary else (1e3, "mm")
    for k, (name, table) in enumerate(sorted(tables.items())):
        where, value, u = table[:, 0] * factor, table[:, 1] * 1e6, 1e6 * table[:, 2]
        mark = {"marker": style.MARKERS[k % len(style.MARKERS)], "ms": 3.5, "lw": 1.2, "label": name}
        style.draw_band(panel, where, value, u, style.COLORS[k % len(style.COLORS)], **mark)
    panel.axhline(0.0, color="0.75", lw=0.8, zorder=0)
    if not any(np.nan_to_num(table[:, 2]).any() for table in tables.values()):
        # Nothing but the datum has a value.
        panel.set(xticks=[], yticks=[])
        style.mark_lost(panel, 0.6)
    panel.set_xlabel(f"{axis}, {unit}")
    panel.set_ylabel("µrad" if next(iter(tables))[1] in "ABC" else "µm")
    panel.legend(fontsize="small", frameon=False, ncols=len(tables), loc="lower left", bbox_to_anchor=(0.0, 0.99))
    panel.margins(x=0.03)


def _headed(squareness: Mapping[str, tuple[float, float]]) -> str:
    parts = [f"{name} = {quantity(value, 'rad', u)}" for name, (value, u) in squareness.items()]
    text = say("picture.motions_bands")
    return together((text, say("picture.squareness", parts=", ".join(parts))), "\n") if parts else text


_ERROR_SHARE = 0.6  # largest error as a share of the distance between neighbours
_SMALLEST_ELLIPSE = 0.014  # smallest ellipse that is seen beside its point, as a share of the map
_ROOM = 0.25  # room that ellipses may take beside the points, as a share of the map
_MOST_LAYERS = 6
_FLAT = 1e-6  # extent of a plane across itself, m
_MOST_ELLIPSES = 1500


@dataclass(frozen=True)
class _Map:
    """What is drawn: m throughout; (n, 3), (n, d), (n, d)."""

    points: Array
    error: Array
    uncertainty: Array

    @property
    def good(self) -> BoolArray:
        return np.asarray(np.isfinite(self.error).all(axis=1))

    def take(self, keep: BoolArray) -> Self:
        return replace(self, points=self.points[keep], error=self.error[keep], uncertainty=self.uncertainty[keep])


def draw_plane(content: Mapping[str, Any]) -> Figure:
    """The map of points that lie in one plane of the machine, seen across it; any other as `draw_map` draws it."""
    points, *errors = (style.numbers(content[key]) for key in ("points", "position_error", "position_error_u"))
    across, *plane = np.argsort(np.ptp(points, axis=0), kind="stable").tolist()
    if np.ptp(points[:, across]) > _FLAT:
        return draw_map(content)
    plane.sort()
    seen = [points[:, [*plane, across]], *(values[:, plane] for values in errors)]
    named = zip(("points", "position_error", "position_error_u"), seen, strict=True)
    return draw_map(dict(named), "".join("xyz"[k] for k in plane))


def draw_map(content: Mapping[str, Any], plane: str = "xy") -> Figure:
    """Nominal and measured positions, with ellipses of expanded uncertainty (k = 2).

    Of a result's error map (document or arrays), with the names of the axes to the right and upwards. A plane is one
    panel; a volume is drawn layer by layer, with the error across the layer as the colour. A direction that is
    determined nowhere is drawn as without error, and named in the title.
    """
    parts = (style.numbers(content[key]) for key in ("points", "position_error", "position_error_u"))
    whole, unknown = _known(_Map(*parts), f"{plane}z")
    flat = whole.error.shape[1] == 2
    layers = [("", whole)] if flat else _layers(whole)
    scale = _magnification(layers[0][1], whole)
    columns = {1: 1, 2: 2, 4: 2}.get(len(layers), 3)
    rows = -(-len(layers) // columns)
    size = (7.2, 7.4) if columns == 1 else (4.6 * columns, 4.7 * rows + 0.6)
    figure = style.new_figure(*size, together((*_headline(whole, scale), *unknown), "\n"))
    panels = np.atleast_1d(figure.subplots(rows, columns, sharex=True, sharey=True)).reshape(-1)
    limit = 0.0 if flat else 1e6 * float(np.nanmax(np.abs(whole.error[:, 2]), initial=0.0))
    larger, largest = _larger(whole, scale), float(np.nanmax(np.abs(whole.error[:, :2]), initial=0.0))
    for panel, (name, layer) in zip(panels, layers, strict=False):
        _layer(panel, layer, scale, larger, limit, largest)
        panel.set_title(name, fontsize="medium")
    for panel in panels[len(layers) :]:
        panel.set_axis_off()
    _finish(figure, list(panels), len(layers), columns, limit, plane)
    return figure


def _known(whole: _Map, axes: str) -> tuple[_Map, list[str]]:
    """The map with zeros in the directions that are determined nowhere, and these in a line for the title."""
    lost = np.asarray(~np.isfinite(whole.error).any(axis=0))
    if lost.all() or not lost.any():
        return whole, []
    names = ", ".join(name for name, gone in zip(axes, lost, strict=False) if gone)
    filled = (np.where(lost, 0.0, values) for values in (whole.error, whole.uncertainty))
    return _Map(whole.points, *filled), [say("text.not_determined_along", names=names)]


def _layers(whole: _Map) -> list[tuple[str, _Map]]:
    """Layers of a volume with their names: some of its levels, or slices where the points lie at random."""
    z = whole.points[:, 2]
    levels = np.unique(np.round(z, 6))
    if len(levels) <= 1 or 4 * len(levels) <= len(z) + 4:
        chosen = levels[np.unique(np.linspace(0, len(levels) - 1, _MOST_LAYERS).round().astype(int))]
        return [(f"z = {level * 1e3:.6g} mm", whole.take(np.abs(z - level) < 1e-6)) for level in chosen]
    edges = np.quantile(z, [0.0, 0.25, 0.5, 0.75, 1.0])
    slices = np.clip(np.searchsorted(edges, z, side="right") - 1, 0, 3)
    return [
        (say("picture.slice", low=f"{edges[k] * 1e3:.4g}", high=f"{edges[k + 1] * 1e3:.4g}"), whole.take(slices == k))
        for k in range(4)
        if (slices == k).any()
    ]


def _headline(whole: _Map, scale: float) -> Iterator[str]:
    if not whole.good.any():
        yield say("picture.no_target", scale=style.spaced(scale))
        return
    yield say("picture.magnified", scale=style.spaced(scale))
    largest = float(np.linalg.norm(whole.error[whole.good], axis=1).max())
    # Along a direction that was not measured there is none.
    expanded = K * float(np.linalg.norm(np.nan_to_num(whole.uncertainty[whole.good]), axis=1).max())
    yield say("picture.largest", error=as_exact(largest, "m", expanded), u=as_exact(expanded, "m", expanded))


def _layer(panel: Axes, layer: _Map, scale: float, larger: float, limit: float, largest: float) -> None:
    """Nominal and measured grid of one layer, seen along z.

    With the magnification of errors, and of ellipses beside them; the largest error along z, um, and across it, m.
    """
    from matplotlib.collections import EllipseCollection, LineCollection

    nominal = layer.points[:, :2] * 1e3
    found = nominal + scale * layer.error[:, :2] * 1e3
    good = layer.good
    pairs = neighbours(layer.points[:, :2])
    if 2 * len(pairs) < len(nominal):
        pairs = pairs[:0]
    for places, color, width in ((nominal, style.NOMINAL, 0.8), (found, style.FOUND, 1.0)):
        panel.add_collection(LineCollection(list(places[pairs]), colors=color, linewidths=width, zorder=1))
    if not len(pairs):
        # No grid: each point is joined to its own nominal place.
        own = np.stack([nominal[good], found[good]], axis=1)
        panel.add_collection(LineCollection(list(own), colors=style.FOUND, linewidths=1.0, zorder=1))
    if good.sum() <= _MOST_ELLIPSES:
        size = 4 * larger * scale * layer.uncertainty[good][:, :2] * 1e3
        panel.add_collection(
            EllipseCollection(
                size[:, 0], size[:, 1], np.zeros(len(size)), units="xy", offsets=found[good],
                offset_transform=panel.transData, facecolor="none", edgecolor=style.BAND, lw=1.1, zorder=2,
            )
        )  # fmt: skip
        # Room for the ellipses, but not for one that hardly anything determines.
        reach = np.minimum(size / 2, _ROOM * np.ptp(nominal, axis=0).max())
        panel.update_datalim(np.vstack([found[good] - reach, found[good] + reach]))
        text = say("picture.U_larger" if larger > 1 else "head.U2", times=f"{larger:g}")
        panel.plot([], [], "o", mfc="none", mec=style.BAND, label=text)
    panel.plot(*nominal.T, ".", color=style.NOMINAL, ms=4, label=say("picture.nominal"), zorder=2)
    if layer.error.shape[1] == 3:
        across = layer.error[good][:, 2] * 1e6
        panel.scatter(
            found[good, 0], found[good, 1], s=34, c=across, cmap=style.DIVERGING, vmin=-limit, vmax=limit, ec="0.2",
            lw=0.5, label=say("picture.measured"), zorder=3,
        )  # fmt: skip
    else:
        panel.plot(*found[good].T, "o", color=style.FOUND, ms=4, label=say("picture.measured"), zorder=3)
    if not good.all():
        panel.plot(*nominal[~good].T, "x", color="black", ms=6, label=say("text.not_determined"), zorder=3)
    panel.set_aspect("equal")
    panel.margins(0.08)
    drawn = np.vstack([nominal, found[good]])
    if largest > 0:
        style.scale_bar(panel, scale, largest, drawn.min(axis=0), drawn.max(axis=0))


def _finish(figure: Figure, panels: list[Axes], count: int, columns: int, limit: float, plane: str) -> None:
    """Labels on the outer panels, one legend, one colour bar."""
    for k, panel in enumerate(panels[:count]):
        if k % columns == 0:
            panel.set_ylabel(f"{plane[1]}, mm")
        if k + columns >= count:
            panel.set_xlabel(f"{plane[0]}, mm")
            panel.tick_params(labelbottom=True)
    seen: dict[str, Any] = {}
    for panel in panels[:count]:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            seen.setdefault(label, handle)
    figure.legend(seen.values(), seen.keys(), loc="outside lower center", ncols=4, frameon=False, fontsize="small")
    shown = next((c for p in panels[:count] for c in p.collections if c.get_array() is not None), None)
    if shown is not None and limit > 0:
        figure.colorbar(shown, ax=panels[:count], label=say("picture.error_z"), shrink=0.7)


def _larger(whole: _Map, scale: float) -> float:
    """How much larger than the errors the ellipses must be drawn to be seen beside their points."""
    typical = scale * K * float(np.nanmedian(whole.uncertainty[:, :2])) if whole.good.any() else 0.0
    seen = _SMALLEST_ELLIPSE * float(np.ptp(whole.points[:, :2], axis=0).max(initial=0.0))
    return 1.0 if not typical > 0 or typical >= seen else max(style.round_down(2 * seen / typical), 1.0)


def neighbours(points: Array) -> np.ndarray:
    """(k, 2) pairs of points (n, d) next to each other along one coordinate, all others equal."""
    keys = np.round(points, 7)
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    for axis in range(keys.shape[1]):
        others = np.delete(keys, axis, axis=1)
        order = np.lexsort((keys[:, axis], *others.T))
        same = np.all(others[order[1:]] == others[order[:-1]], axis=1)
        pairs.append(np.column_stack([order[:-1], order[1:]])[same])
    return np.concatenate(pairs)


def _magnification(layer: _Map, whole: _Map) -> float:
    """Round number that makes the largest error a good part of the distance between neighbours."""
    steps = [np.diff(np.unique(np.round(layer.points[:, j], 7))) for j in range(2)]
    # A grid has few different places along an axis; of points at random the mean distance counts.
    even = [float(np.median(s)) for s in steps if 0 < len(s) <= 2 * np.sqrt(len(layer.points)) + 2]
    spread = float(np.ptp(layer.points[:, :2], axis=0).max(initial=0.0)) / np.sqrt(max(len(layer.points), 1))
    smallest = min(even, default=spread) or 0.1
    largest = float(np.nanmax(np.abs(whole.error[:, :2]), initial=0.0))
    return style.round_down(_ERROR_SHARE * smallest / largest) if largest > 0 else 1.0
