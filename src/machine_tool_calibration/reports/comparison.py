# SPDX-License-Identifier: Apache-2.0
"""A comparison in plain words, and for programs as one JSON document."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.diagnosis.compare import Comparison, JointComparison, Overall
from machine_tool_calibration.methods.build import error_map, suspicious_fits
from machine_tool_calibration.reports.documents import plain
from machine_tool_calibration.reports.goodness import fit_words, fits, scatter_words
from machine_tool_calibration.reports.quantities import quantity, rounded
from machine_tool_calibration.residuals.noise import Noise
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say, together

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["comparison_document", "in_words", "records", "stand_out", "times_declared"]


# p-value at which repeats speak against the model.
_LACK = 0.003
# Share of the misfit that repeats must show to be called as large.
_NOISE = 0.7
# How much worse than all readings together a setup must be to be named.
_WORSE = 1.15


def in_words(comparison: Comparison | JointComparison) -> str:
    """What a person wants to know first: does the model fit, and if not, where not; lengths in micrometres."""
    one = comparison if isinstance(comparison, Comparison) else None
    overall, count = comparison.overall, len(comparison.outliers)
    fitting = scatter_words(_map_of(one), overall.p_value) if one else None
    fitting = fitting or fit_words(overall.reduced_chi_square, overall.p_value)
    bad = fits(overall.p_value) == "bad" and fitting.key != "fit.one_direction"
    said: list[str] = [fitting]
    said += [_where(comparison.parts, "setup" if one else "session", overall)] if bad else []
    said += [say("compared.sentence", text=stand_out(count))] if count else []
    said += [_repeats(overall, one.noise, not bad or bool(count))] if one else []
    said += [say("compared.ask_diagnosis" if one else "compared.ask_result")] if bad else []
    return together(said)


def _where(parts: pd.DataFrame, part: str, overall: Overall) -> str:
    """Which of the setups or sessions it fits worst."""
    judged = parts[parts["reduced_chi_square"].notna()]
    if len(judged) < 2:
        return say(f"compared.one_{part}")
    worst = judged.iloc[0]
    if worst["reduced_chi_square"] < _WORSE**2 * overall.reduced_chi_square:
        return say(f"compared.same_{part}")
    ratio = times_declared(worst["reduced_chi_square"])
    return say(f"compared.worst_{part}", name=worst["name"], ratio=ratio, share=f"{worst['share']:.0%}")


def _map_of(one: Comparison) -> Mapping[str, Any]:
    """What the map of deviations that were read directly says of their scatter; empty for other methods."""
    alone = len(one.fit.joint.assembly.models) == 1
    return error_map(one.fit).content if alone and spec_of(one.session).reads_machine else {}


def _repeats(overall: Overall, noise: Noise, explained: bool) -> str:
    if noise.from_repeats is None:
        return say("compared.few_repeats")
    if noise.lack_of_fit_p is not None and noise.lack_of_fit_p < _LACK:
        key = "lack"
    elif explained:
        key = "scatter"
    else:
        key = "less" if noise.from_repeats < _NOISE * overall.ratio * noise.declared else "as_much"
    repeats, declared = (quantity(size, "m") for size in (noise.from_repeats, noise.declared))
    return say(f"compared.{key}", repeats=repeats, declared=declared)


def stand_out(count: int) -> str:
    """That so many readings do not belong to the rest."""
    return say("compared.stand_out", n=count)


def times_declared(reduced_chi_square: float | None) -> str:
    """How many times the declared uncertainty readings scatter about the model; a dash where that is not known."""
    return rounded(reduced_chi_square and reduced_chi_square**0.5)


def records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a table by their columns, with None for NaN."""
    return [plain(row) for row in table.to_dict("records")]


def comparison_document(comparison: Comparison | JointComparison) -> dict[str, Any]:
    """The comparison as `mtcal-comparison/1`: SI units, None where the model takes a figure up.

    Of several sessions the same keys for all of them together, and under `sessions` those of each.
    """
    sessions = [one.session for one in comparison.sessions]
    worst = comparison.worst.filter(["session", "row", "setup", "residual", "studentized"])
    out = {
        "format": "mtcal-comparison/1",
        "method": sessions[0].method if isinstance(comparison, Comparison) else "joint",
        "effects": list(comparison.effects),
        "summary": in_words(comparison),
        "suspicious": suspicious_fits([one.fit for one in comparison.sessions], comparison.labels),
        "provenance": comparison.provenance.document(),
        **vars(comparison.overall),
        "setups": records(comparison.setups),
        "worst": records(worst),
    }
    if isinstance(comparison, JointComparison):
        labelled = zip(comparison.labels, comparison.sessions, strict=True)
        return out | {"sessions": [{"label": label, **comparison_document(one)} for label, one in labelled]}
    ends = comparison.regions[["axis", "low", "high"]]
    fit = records(comparison.regions.drop(columns=[*ends]))
    return out | {
        "noise": {"declared": comparison.noise.declared, "from_repeats": comparison.noise.from_repeats},
        "lack_of_fit_p_value": comparison.noise.lack_of_fit_p,
        "runs": records(comparison.runs),
        "labels": {name: records(table) for name, table in comparison.texts.items()},
        "regions": [{**region, "fit": own} for region, own in zip(records(ends), fit, strict=True)],
        "approaches": records(comparison.approaches),
        "trends": records(comparison.trends),
        "depends_on": [{"covariate": name, "share": share} for name, share in comparison.ranked],
        "outliers": list(comparison.outliers),
    }
