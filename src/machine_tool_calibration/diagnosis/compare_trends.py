"""Trends of a comparison as a table: what changed together makes one line, and what says nothing makes none."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.diagnosis.compare_figures import chance, expanded
from machine_tool_calibration.diagnosis.comparison import Comparison, Trend
from machine_tool_calibration.diagnosis.report import TextTable

__all__ = ["together", "trends_table"]

_MICRO = 1e6
_MOST = 8
# Correlation from which two covariates changed together, so that a line over one is a line over the other.
_TOGETHER = 0.9
# Chance above which a line says nothing, and how many are shown all the same.
_NOTHING, _LEAST = 0.05, 1


def trends_table(comparison: Comparison) -> TextTable:
    """Straight lines over time, temperature and every other covariate, the clearest first."""
    told = [t for t in comparison.trends if t.slope is not None and t.added is not None]
    groups = together(comparison, told)
    clear = [group for group in groups if (group[0].p_value or 0.0) < _NOTHING]
    shown = (clear or groups[:_LEAST])[:_MOST]
    rows = tuple(
        (
            first.covariate,
            ", ".join(sorted((t.covariate for t in others), key=lambda name: name != "time")),
            expanded(first.slope, first.slope_u, _MICRO * first.span),
            expanded(first.added, first.added_u, _MICRO * first.span),
            chance(first.p_value),
        )
        for first, *others in shown
    )
    columns = ("over", "with it went", "residuals change by / µm", "the model would need / µm", "chance")
    return TextTable(
        "Straight lines over time, temperature and what else was recorded", columns, rows, _note(comparison, shown)
    )


def together(comparison: Comparison, trends: list[Trend]) -> list[list[Trend]]:
    """Trends whose covariates changed together, in the order of the clearest of each; that one leads its group."""
    groups: list[list[Trend]] = []
    for trend in trends:
        values = comparison.covariates[trend.covariate]
        for group in groups:
            if abs(np.corrcoef(values, comparison.covariates[group[0].covariate])[0, 1]) > _TOGETHER:
                group.append(trend)
                break
        else:
            groups.append([trend])
    return groups


def _note(comparison: Comparison, shown: list[list[Trend]]) -> str:
    tried = len(comparison.trends)
    notes = [
        "from one end of what was recorded to the other; the model would need more than the residuals show, "
        "because its other unknowns take a part up"
    ]
    if any(len(group) > 1 for group in shown):
        notes.append("what went together cannot be told apart here")
    listed = {t.covariate for group in shown for t in group}
    rest = [t.covariate for t in comparison.trends if t.covariate not in listed and t.slope is not None]
    if rest:
        notes.append(f"nothing clear over {', '.join(rest)}")
    hidden = [t.covariate for t in comparison.trends if t.slope is None or t.added is None]
    if hidden:
        notes.append(f"the model's own unknowns take up what there is over {', '.join(hidden)}")
    notes.append(
        f"{tried} tried: the smallest chance of so many is about {1 / (tried + 1):.1g} where nothing is the matter; "
        "`mtcal diagnose` allows for that"
    )
    return "; ".join(notes)
