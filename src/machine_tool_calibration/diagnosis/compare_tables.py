"""A comparison as tables of text, in micrometres."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from machine_tool_calibration.diagnosis.comparison import Comparison, Share
from machine_tool_calibration.diagnosis.report import TextTable

__all__ = ["comparison_tables"]

_MICRO = 1e6
_MOST_PARTS, _MOST_LABELS, _MOST_TRENDS = 12, 5, 8
_HOUR = 3600.0
# Names and factors of positions for people.
_UNITS = {"x": ("mm", 1e3), "y": ("mm", 1e3), "z": ("mm", 1e3), "c": ("deg", 180.0 / math.pi)}


def comparison_tables(comparison: Comparison) -> Iterator[TextTable]:
    """Where the model fails: the whole, setups, regions, approaches, trends, single readings."""
    yield _overall(comparison)
    yield _parts("Setups, worst first", "setup", comparison.setups, _MOST_PARTS)
    if len(comparison.runs) > len(comparison.setups):
        yield _parts("Repeats, worst first", "setup and repeat", comparison.runs, _MOST_LABELS)
    for name, shares in comparison.labels.items():
        if len(shares) > 1:
            yield _labels(name, shares)
    if comparison.regions:
        yield _regions(comparison)
    if comparison.approaches:
        yield _approaches(comparison)
    if comparison.trends:
        yield _trends(comparison)
    yield _worst(comparison)


def _overall(comparison: Comparison) -> TextTable:
    overall = comparison.overall
    repeats = overall.noise.from_repeats
    rows = [
        ("RMS of measured − predicted", f"{_MICRO * overall.rms:.3g} µm"),
        ("declared standard uncertainty", f"{_MICRO * overall.noise.declared:.3g} µm"),
        ("scatter of repeated readings", "–" if repeats is None else f"{_MICRO * repeats:.3g} µm"),
        ("reduced chi-square", f"{overall.reduced_chi_square:.3g}, {overall.degrees_of_freedom} degrees of freedom"),
        ("chance of so much, if the model is right", _chance(overall.p_value)),
    ]
    if overall.noise.lack_of_fit_p is not None:
        rows.append(("chance that places differ so much more than repeats", _chance(overall.noise.lack_of_fit_p)))
    return TextTable(f"{overall.readings} readings", ("", ""), tuple(rows))


def _parts(title: str, head: str, shares: Sequence[Share], most: int) -> TextTable:
    rows = tuple(
        (
            share.name,
            str(share.readings),
            f"{_MICRO * share.rms:.3g}",
            _times(share),
            f"{share.share:.0%}",
            _with(share.mean, share.mean_u, _MICRO),
            _with(share.slope, share.slope_u, _MICRO * _HOUR),
            "" if share.worst_row is None else str(share.worst_row),
        )
        for share in shares[:most]
    )
    columns = (head, "readings", "RMS/µm", "× declared", "of all squares", "mean/µm", "slope/(µm/h)", "worst row")
    note = "± is the expanded uncertainty (k = 2); a dash: the model's own unknowns take it up"
    if len(shares) > most:
        note = f"{len(shares) - most} more; {note}"
    return TextTable(title, columns, rows, note)


def _labels(name: str, shares: Sequence[Share]) -> TextTable:
    rows = tuple(
        (s.name, str(s.readings), f"{_MICRO * s.rms:.3g}", _times(s), f"{s.share:.0%}", str(s.worst_row))
        for s in shares[:_MOST_LABELS]
    )
    more = f"{len(shares) - _MOST_LABELS} more" if len(shares) > _MOST_LABELS else ""
    columns = (name, "readings", "RMS/µm", "× declared", "of all squares", "worst row")
    return TextTable(f"By {name}, worst first", columns, rows, more)


def _regions(comparison: Comparison) -> TextTable:
    rows = []
    for axis in dict.fromkeys(region.axis for region in comparison.regions):
        mine = [region for region in comparison.regions if region.axis == axis]
        unit, factor = _UNITS[axis]
        worst = sorted(mine, key=lambda region: -(region.fit.reduced_chi_square or 0.0))
        for region in worst[:3]:
            low, high = (f"{factor * value:.4g}" for value in (region.low, region.high))
            where = low if low == high else f"{low} to {high}"
            share = region.fit
            rows.append(
                (
                    axis,
                    f"{where} {unit}",
                    str(share.readings),
                    f"{_MICRO * share.rms:.3g}",
                    _times(share),
                    _with(share.mean, share.mean_u, _MICRO),
                )
            )
    columns = ("axis", "position", "readings", "RMS/µm", "× declared", "mean/µm")
    return TextTable("Regions of each axis, the three worst", columns, tuple(rows))


def _approaches(comparison: Comparison) -> TextTable:
    rows = tuple(
        (
            a.axis,
            f"{a.forward} / {a.backward}",
            _with(a.difference, a.difference_u, _MICRO),
            _with(a.displacement, a.displacement_u, _MICRO) + (" µrad" if a.axis == "c" and a.displacement else ""),
            _chance(a.p_value),
        )
        for a in comparison.approaches
    )
    columns = ("axis", "readings + / −", "mean after + minus after −/µm", "as a displacement of the axis/µm", "p")
    return TextTable("Direction of approach", columns, rows)


def _trends(comparison: Comparison) -> TextTable:
    rows = tuple(
        (
            t.covariate,
            _with(t.slope, t.slope_u, _MICRO * t.span),
            _with(t.added, t.added_u, _MICRO * t.span),
            _chance(t.p_value),
        )
        for t in comparison.trends[:_MOST_TRENDS]
    )
    columns = ("over", "change of the residuals over its range/µm", "the same, if added to the model/µm", "p")
    tried = len(comparison.trends)
    chance = 1 / (tried + 1)
    note = f"{tried} tried: by chance alone the smallest p is about {chance:.1g}; `mtcal diagnose` allows for that"
    return TextTable("Straight lines over time, temperature and other covariates", columns, rows, note)


def _worst(comparison: Comparison) -> TextTable:
    readings = comparison.fit.model.observations.readings
    ids = comparison.fit.model.observations.session.setup_ids
    labels = tuple(readings.labels)
    rows = tuple(
        (
            str(readings.row[k]),
            ids[readings.setup[k]],
            str(readings.repeat[k]),
            *(str(readings.labels[name][k]) for name in labels),
            f"{_MICRO * comparison.residual[k]:+.3g}",
            f"{comparison.studentized[k]:+.2f}",
        )
        for k in comparison.worst[:_MOST_LABELS]
    )
    columns = ("row", "setup", "repeat", *labels, "residual/µm", "studentized")
    return TextTable("Single readings, worst first (rows count from 0)", columns, rows)


def _times(share: Share) -> str:
    return "–" if share.reduced_chi_square is None else f"{share.reduced_chi_square**0.5:.2f}"


def _with(value: float | None, uncertainty: float | None, factor: float) -> str:
    """A value with its expanded uncertainty (k = 2)."""
    if value is None or uncertainty is None:
        return "–"
    expanded = 2 * factor * uncertainty
    places = 1 - math.floor(math.log10(expanded)) if expanded > 0 else 3
    if not 0 <= places <= 6:
        return f"{factor * value:+.2g} ± {expanded:.2g}"
    return f"{factor * value:+.{places}f} ± {expanded:.{places}f}"


def _chance(p: float | None) -> str:
    if p is None:
        return "–"
    return f"{p:.2g}" if p >= 1e-4 else "< 0.0001"
