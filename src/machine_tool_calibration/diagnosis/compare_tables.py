"""A comparison as tables of text, in micrometres."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from machine_tool_calibration.diagnosis.compare_figures import chance, expanded, untold
from machine_tool_calibration.diagnosis.compare_trends import trends_table
from machine_tool_calibration.diagnosis.comparison import Approach, Comparison, JointComparison, Share
from machine_tool_calibration.diagnosis.quantities import micrometres, quantity
from machine_tool_calibration.diagnosis.report import TextTable

__all__ = ["comparison_tables", "joint_tables"]

_MICRO = 1e6
_MOST_PARTS, _MOST_LABELS = 12, 5
_HOUR = 3600.0
_HEADS = "× declared: scatter over the declared uncertainty; of all misfit: share of the sum of squares"
# Names and factors of positions for people.
_UNITS = {"x": ("mm", 1e3), "y": ("mm", 1e3), "z": ("mm", 1e3), "c": ("deg", 180.0 / math.pi)}


def comparison_tables(comparison: Comparison) -> Iterator[TextTable]:
    """Where the model fails: the whole, setups, regions, approaches, trends, single readings."""
    yield _overall(comparison)
    setups = _parts("Setups, worst first", "setup", comparison.setups, _MOST_PARTS)
    yield replace(setups, note=f"{_HEADS}; {setups.note}".removesuffix("; "))
    yield from _within(comparison)


def _within(comparison: Comparison) -> Iterator[TextTable]:
    """What follows the setups of a session."""
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
        yield trends_table(comparison)
    yield _worst(comparison)


def joint_tables(comparison: JointComparison) -> Iterator[TextTable]:
    """Where the model of several sessions fails: sessions, setups of all, and what else is in each session."""
    joint = comparison.joint
    rows = (
        ("measured − predicted, RMS", quantity(comparison.rms, "m")),
        (
            "reduced chi-square (1 if the model and the declared uncertainty are right)",
            f"{joint.reduced_chi_square:.3g}, {joint.solution.degrees_of_freedom} degrees of freedom",
        ),
        ("chance of so large a scatter, if the model is right", chance(joint.p_value)),
    )
    yield TextTable(f"All {comparison.readings} readings of {len(comparison.labels)} sessions", ("", ""), rows)
    parts = [share for _, share in comparison.parts]
    yield _parts("Sessions, worst first", "session", parts, len(parts))
    named = [replace(share, name=f"{label}/{share.name}") for label, share in comparison.setups]
    setups = _parts("Setups of all sessions, worst first", "setup", named, _MOST_PARTS)
    yield replace(setups, note=f"{_HEADS}; {setups.note}".removesuffix("; "))
    for label, one in zip(comparison.labels, comparison.sessions, strict=True):
        for table in _within(one):
            yield replace(table, title=f"{label}: {table.title[0].lower()}{table.title[1:]}")


def _overall(comparison: Comparison) -> TextTable:
    overall = comparison.overall
    repeats = overall.noise.from_repeats
    rows = [
        ("measured − predicted, RMS", quantity(overall.rms, "m")),
        ("declared standard uncertainty of a reading", quantity(overall.noise.declared, "m")),
        (
            "scatter of readings repeated at one place",
            "not repeated often enough to tell" if repeats is None else quantity(repeats, "m"),
        ),
        (
            "reduced chi-square (1 if the model and the declared uncertainty are right)",
            f"{overall.reduced_chi_square:.3g}, {overall.degrees_of_freedom} degrees of freedom",
        ),
        ("chance of so large a scatter, if the model is right", chance(overall.p_value)),
    ]
    if overall.noise.lack_of_fit_p is not None:
        rows.append(("chance that places differ so much more than repeats do", chance(overall.noise.lack_of_fit_p)))
    note = "every ± below is an expanded uncertainty (k = 2)"
    return TextTable(f"All {overall.readings} readings", ("", ""), tuple(rows), note)


def _parts(title: str, head: str, shares: Sequence[Share], most: int) -> TextTable:
    rows = tuple(
        (
            share.name,
            str(share.readings),
            micrometres(share.rms),
            _times(share),
            f"{share.share:.0%}",
            expanded(share.mean, share.mean_u, _MICRO),
            expanded(share.slope, share.slope_u, _MICRO * _HOUR),
            "" if share.worst_row is None else str(share.worst_row),
        )
        for share in shares[:most]
    )
    columns = (head, "readings", "RMS / µm", "× declared", "of all misfit", "mean / µm", "drift / (µm/h)", "worst row")
    shown, note = untold(columns, rows, (5, 6))
    if len(shares) > most:
        note = f"{len(shares) - most} more; {note}".removesuffix("; ")
    return TextTable(title, columns, shown, note)


def _labels(name: str, shares: Sequence[Share]) -> TextTable:
    rows = tuple(
        (s.name, str(s.readings), micrometres(s.rms), _times(s), f"{s.share:.0%}", str(s.worst_row))
        for s in shares[:_MOST_LABELS]
    )
    more = f"{len(shares) - _MOST_LABELS} more" if len(shares) > _MOST_LABELS else ""
    columns = (name, "readings", "RMS / µm", "× declared", "of all misfit", "worst row")
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
                    micrometres(share.rms),
                    _times(share),
                    expanded(share.mean, share.mean_u, _MICRO),
                )
            )
    columns = ("axis", "position", "readings", "RMS / µm", "× declared", "mean / µm")
    shown, note = untold(columns, tuple(rows), (5,))
    return TextTable("Regions of each axis, the three worst", columns, shown, note)


def _approaches(comparison: Comparison) -> TextTable:
    rows = tuple(
        (
            a.axis,
            f"{a.forward} / {a.backward}",
            expanded(a.difference, a.difference_u, _MICRO),
            _apart(a),
            chance(a.p_value),
        )
        for a in comparison.approaches
    )
    columns = ("axis", "readings after + / −", "residual after + minus after − / µm", "axis stands apart by", "chance")
    shown, note = untold(columns, rows, (2, 3))
    note = (
        "axis stands apart by: what the two directions would have to differ by on the axis (a backlash of half width b "
        f"gives −2 b); chance: that noise alone makes so much; {note}"
    ).removesuffix("; ")
    return TextTable("Direction of approach", columns, shown, note)


def _apart(approach: Approach) -> str:
    text = expanded(approach.displacement, approach.displacement_u, _MICRO)
    return text if approach.displacement is None else f"{text} {'µrad' if approach.axis == 'c' else 'µm'}"


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
            f"{_MICRO * comparison.residual[k]:+.2f}",
            f"{comparison.studentized[k]:+.1f}",
        )
        for k in comparison.worst[:_MOST_LABELS]
    )
    columns = ("row", "setup", "repeat", *labels, "residual / µm", "× expected")
    note = (
        "× expected: over the scatter that the declared uncertainty lets this residual have; row 0 is the second line "
        "of observations.csv"
    )
    return TextTable("Single readings, worst first", columns, rows, note)


def _times(share: Share) -> str:
    return "–" if share.reduced_chi_square is None else f"{share.reduced_chi_square**0.5:.2f}"
