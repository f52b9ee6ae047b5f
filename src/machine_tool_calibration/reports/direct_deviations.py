# SPDX-License-Identifier: Apache-2.0
"""Deviations that were read directly: their scatter, and the steps of the model of a plate."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from machine_tool_calibration.reports.goodness import fits
from machine_tool_calibration.reports.quantities import micrometres, probability, quantity, rounded
from machine_tool_calibration.reports.tables import TextTable, heads
from machine_tool_calibration.words import Said, say, together

__all__ = ["direct_tables", "scatter_words"]

# p-value below which a step or a parameter counts as significant.
_SIGNIFICANT = 0.01


def scatter_words(content: Mapping[str, Any], p_value: float) -> Said | None:
    """How the readings scatter, what was declared, and which of them the uncertainties use; None for other methods."""
    scatter = content.get("scatter")
    if scatter is None or scatter["found"] is None:
        return None
    found, declared = scatter["found"], scatter["declared"]
    both, ratio = _both(found, declared), rounded(found / declared)
    if fits(p_value) == "bad" and fits(scatter.get("one_direction_p_value", 0.0)) != "bad":
        return say("fit.one_direction", both=_both(scatter["one_direction"], declared))
    if scatter["uncertainties_from"] == "scatter":
        return say("fit.scatter_used", ratio=ratio, both=both)
    if fits(p_value) == "bad":
        # What differs from run to run takes it up, so that the scatter beside that is as declared.
        return say("fit.runs_differ", ratio=ratio, both=both)
    if fits(p_value) == "too well":
        return say("fit.declared_used", ratio=ratio, both=both)
    return say("fit.scatter_as_declared", both=both)


def _both(found: float, declared: float) -> Said:
    return say("fit.scatter", found=quantity(found, "m"), declared=quantity(declared, "m"))


def direct_tables(content: Mapping[str, Any]) -> Iterator[TextTable | str]:
    """Tables and sentences, in the order in which they are read."""
    plate = content.get("plate")
    if plate:
        yield _plate_table(plate)
        yield from _plate_words(plate)


def _plate_table(plate: Mapping[str, Any]) -> TextTable:
    title = say("plate.title", n=plate["places"])
    rows = (
        (
            step["model"],
            str(step["unknowns"]),
            micrometres(step["rms"]),
            micrometres(step["scatter"]),
            probability(step["p_value"]) if "p_value" in step else "",
            together(map(_size, step["parameters"]), "\n"),
        )
        for step in plate["steps"]
    )
    return TextTable(title, heads("model", "unknowns", "rms_um", "scatter_um", "p_of_step", "sizes"), tuple(rows))


def _plate_words(plate: Mapping[str, Any]) -> Iterator[str]:
    steps = plate["steps"]
    known = [p for step in steps[1:3] for p in step["parameters"] if p["value"] is not None]
    good = [p["of"] for p in known if _is(p)]
    not_good = [p["of"] for p in known if not _is(p)]
    words = []
    if good:
        words.append(say("plate.significant", level=f"{_SIGNIFICANT}", names=", ".join(good)))
    if not_good:
        words.append(say("plate.not_significant", names=", ".join(not_good)))
    if len(steps) > 3:
        more = "curves" if steps[3]["p_value"] < _SIGNIFICANT else "no_curves"
        fell = steps[2]["scatter"] - steps[3]["scatter"]
        words.append(say(f"plate.{more}_take" if fell > 0 else f"plate.{more}", size=quantity(fell, "m")))
    yield together(words)


def _is(parameter: Mapping[str, Any]) -> bool:
    return parameter["p_value"] is not None and parameter["p_value"] < _SIGNIFICANT


def _size(parameter: Mapping[str, Any]) -> Said:
    name = parameter["of"]
    if parameter["value"] is None:
        return say("plate.lost", name=name)
    size = quantity(parameter["value"], parameter["unit"], parameter["standard_uncertainty"])
    return say("plate.size" if _is(parameter) else "plate.small_size", name=name, size=size)
