# SPDX-License-Identifier: Apache-2.0
"""What `mtcal budget` and `mtcal conformity` tell: contributors, verdicts, and the documents for programs."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

from machine_tool_calibration.budget.conformity import VOLUMETRIC, Conformity
from machine_tool_calibration.budget.propagate import DRAWS, KNOWN, REPEATABILITY, Budget, Drawn, Line, Sum
from machine_tool_calibration.budget.published import POSITION_ERROR
from machine_tool_calibration.machine.error_motions import ERROR_MOTIONS, SQUARENESS, parse_motion
from machine_tool_calibration.reports.documents import picked
from machine_tool_calibration.reports.quantities import NOT_DETERMINED, in_digits_of, micrometres, quantity, rounded
from machine_tool_calibration.reports.tables import Part, TextTable, heads, suspicion_words, table
from machine_tool_calibration.words import named, say, together

_LEAST_NAMED = 1.0  # %
# Figures of ISO 230-2, ISO 230-6 and ISO 230-4 that are told unless others are asked for.
_USUAL = ("B", "B_mean", "R", "E", "M", "A", "E_D", "B_D", "G_ccw", "G_cw", "G_b", "H")
_MOST_DEGREES_OF_FREEDOM = 1000  # degrees of freedom above which k is 2 to three figures
# Share, and standard uncertainty of a reading, m, below which a number says no more than that it is small.
_LEAST_SHARE, _LEAST_READING = 0.001, 1e-9


def chosen_sums(budget: Budget, names: Sequence[str]) -> list[Sum]:
    """The largest uncertainty of each quantity, and the root mean square of the position error.

    If none is asked for, those of position error, error motions, squareness and the usual figures of the standards.
    """
    usual = {POSITION_ERROR, *ERROR_MOTIONS, *SQUARENESS}
    every = [q.name for q in budget.numbers.quantities if q.name in usual or q.figure in _USUAL]
    out = []
    for name in names or sorted(every, key=lambda name: name != POSITION_ERROR):
        out.append(budget.largest(name))
        if name == POSITION_ERROR:
            out.append(budget.rms(name))
    return [one for one in out if one is not None]


def sum_name(one: Sum) -> str:
    """The quantity, and which of its numbers."""
    name = say("budget.position_error_per_axis") if one.quantity.name == POSITION_ERROR else one.quantity.name
    if one.index is None:
        return say("budget.rms_of", name=name)
    return say("budget.largest_of", name=name) if one.quantity.count > 1 else name


def _title(one: Sum) -> str:
    """The same with the unit, for a column."""
    return say("budget.in_unit", what=sum_name(one), unit=unit_of(one)[1])


def _quantity_name(one: Sum) -> str:
    return say("result.position_error") if one.quantity.name == POSITION_ERROR else one.quantity.name


def unit_of(one: Sum) -> tuple[float, str]:
    """Factor from SI, and the unit shown."""
    unit = one.quantity.unit
    return (1e6, "µ" + unit) if unit in ("m", "rad") else (1.0, unit)


def budget_parts(budget: Budget, names: Sequence[str] = ()) -> Iterator[Part]:
    """A budget in tables and sentences: of those quantities, or of those that are told of every measurement."""
    yield _contributors(budget)
    sums = chosen_sums(budget, names)
    detailed = sums if names else [one for one in sums if one.quantity.name == POSITION_ERROR] or sums[:2]
    if detailed:
        yield _contributions(budget, detailed)
    # Those in detail come first.
    if len(sums) > len(detailed):
        yield _overview(budget, sums[len(detailed) :])
    if budget.drawn is not None and sums:
        yield _check(budget.drawn, sums)
    yield from _remarks(budget, sums)


def _contributors(budget: Budget) -> TextTable:
    return table(
        say("budget.contributors"),
        [(line, line.contributor) for line in budget.lines if line.contributor is not None],
        contributor=lambda one: line_name(one[0]),
        type=lambda one: one[1].type,
        distribution=lambda one: named("distribution", one[1].distribution),
        u=lambda one: (
            quantity(one[1].u, one[1].unit) if one[1].unit != "1" or one[1].enters == "length" else rounded(one[1].u)
        ),
        nu=lambda one: "" if one[1].degrees_of_freedom is None else f"{one[1].degrees_of_freedom:g}",
        enters_by=lambda one: say(f"enters.{one[1].enters}"),
        varies_with=lambda one: say(f"varies.{one[1].varies}"),
        in_a_reading=lambda one: micrometres(one[0].reading) if one[0].reading >= _LEAST_READING else "< 0.001",
    )


def _contributions(budget: Budget, sums: Sequence[Sum]) -> TextTable:
    rows = []
    for k, line in enumerate(budget.lines):
        if line.name == REPEATABILITY and not any(one.shares[k].u for one in sums):
            continue
        rows.append((line_name(line), *(_part(one, k) for one in sums)))
    rows += [
        (say("budget.combined"), *(_shown(one, one.u) for one in sums)),
        (say("budget.freedom"), *(_degrees_of_freedom(one.degrees_of_freedom) for one in sums)),
        (say("budget.coverage"), *(f"{one.k:.2f}" for one in sums)),
        (say("budget.expanded"), *(_shown(one, one.expanded, 0) for one in sums)),
        (say("budget.u_readings"), *(_shown(one, one.u_identification) for one in sums)),
    ]
    return TextTable(say("budget.contribute"), (*heads("contributor"), *map(_title, sums)), tuple(rows))


def line_name(line: Line) -> str:
    """A contributor with its symbol."""
    symbol, name = line.contributor.symbol if line.contributor else "", named("contributor", line.name)
    return say("budget.contributor", symbol=symbol, name=name) if symbol else name


def _shown(one: Sum, value: float, more: int = 1) -> str:
    """An uncertainty beside U of its quantity, which has two figures, and what makes it up one decimal more."""
    factor = unit_of(one)[0]
    return f"{in_digits_of(factor * one.expanded, factor * value, more):>6}"


def _part(one: Sum, k: int) -> str:
    part = one.shares[k]
    if not part.u or part.share < _LEAST_SHARE / 100.0:
        return f"{'0':>6}"
    share = f"{100.0 * part.share:.1f}" if part.share >= _LEAST_SHARE else "< 0.1"
    return f"{_shown(one, part.u)} {share:>6} %"


def _degrees_of_freedom(value: float) -> str:
    if value <= _MOST_DEGREES_OF_FREEDOM:
        return f"{value:>6.0f}"
    return f"{'∞' if math.isinf(value) else f'> {_MOST_DEGREES_OF_FREEDOM}':>6}"


def _overview(budget: Budget, sums: Sequence[Sum]) -> TextTable:
    return table(
        say("budget.further"),
        sums,
        quantity=_title,
        u=lambda one: _shown(one, one.u).strip(),
        k=lambda one: f"{one.k:.2f}",
        U=lambda one: _shown(one, one.expanded, 0).strip(),
        u_readings=lambda one: _shown(one, one.u_identification).strip(),
        most_from=lambda one: _most(budget, one),
    )


def _most(budget: Budget, one: Sum) -> str:
    shares = sorted(zip(budget.lines, one.shares, strict=True), key=lambda pair: -pair[1].share)[:2]
    told = [(line_name(line), 100.0 * part.share) for line, part in shares]
    return together((say("budget.share", name=n, share=f"{p:.0f}") for n, p in told if p >= _LEAST_NAMED), ", ")


def _check(drawn: Drawn, sums: Sequence[Sum]) -> TextTable:
    def interval(one: Sum) -> str:
        low, high = (rounded(unit_of(one)[0] * end) for end in drawn.interval(one.index or 0))
        return say("text.range", low=low, high=high)

    return table(
        say("budget.check", n=len(drawn.deviation)),
        [one for one in sums if one.index is not None],
        quantity=_title,
        u_linear=lambda one: _shown(one, one.u).strip(),
        u_drawn=lambda one: _shown(one, float(drawn.u[one.index])).strip(),
        deviations_95=interval,
    )


def _remarks(budget: Budget, sums: Sequence[Sum]) -> Iterator[str]:
    places = [
        say("budget.quantity_where", name=_quantity_name(one), where=one.where)
        for one in sums
        if one.where and one.index is not None
    ]
    if places:
        yield say("budget.largest", places=together(places, "; "))
    # Also where only some of a quantity's numbers are so, of which none is the largest.
    above = budget.numbers.u > budget.u
    more = {_quantity_name(one): bool(above[one.index]) for one in reversed(sums) if one.index is not None}
    some = [_quantity_name(one) for one in sums if above[one.quantity.members].any()]
    for key, is_largest in (("budget.readings_show_more", True), ("budget.readings_show_more_some", False)):
        if names := [name for name in dict.fromkeys(some) if more.get(name, True) is is_largest]:
            yield say(key, names=together(names, ", "))
    if taken := [named("contributor", line.name) for line in budget.lines if line.how == "draws"]:
        own = f"{100 / math.sqrt(2 * DRAWS):.0f}"
        yield say("budget.drawn", n=DRAWS, share=own, names=together(taken, ", "))
    if any(line.name == KNOWN for line in budget.lines):
        yield say("budget.known", name=named("contributor", KNOWN))


def budget_document(budget: Budget, names: Sequence[str] = ()) -> dict[str, Any]:
    """The budget for programs, SI; what is not determined is None. A ModelError if a name is not published."""
    return {
        "format": "mtcal-budget-result/1",
        "provenance": budget.origin.document(),
        "contributors": [_line_document(line) for line in budget.lines],
        "quantities": [_sum_document(budget, one) for one in chosen_sums(budget, names)],
        "draws": 0 if budget.drawn is None else len(budget.drawn.deviation),
    }


def _line_document(line: Line) -> dict[str, Any]:
    c, said = line.contributor, dict[str, Any]()
    if c is not None:
        said = picked(c, "symbol", "type", "distribution", "unit", "degrees_of_freedom", "enters", "varies", "source")
        said["standard_uncertainty"] = c.u
    reading = line.reading if math.isfinite(line.reading) else None
    return {"name": line.name, **said, "in_one_reading": reading, "by": line.how}


def _sum_document(budget: Budget, one: Sum) -> dict[str, Any]:
    dof, own = one.degrees_of_freedom, one.u_identification
    out: dict[str, Any] = {
        "name": one.quantity.name,
        "unit": one.quantity.unit,
        "which": "rms" if one.index is None else "largest",
        "where": one.where,
        "value": None if one.index is None else float(budget.numbers.value[one.index]),
        "contributions": [
            {"name": line.name, "standard_uncertainty": part.u, "share": part.share}
            for line, part in zip(budget.lines, one.shares, strict=True)
        ],
        "standard_uncertainty": one.u,
        "effective_degrees_of_freedom": None if math.isinf(dof) else dof,
        "coverage_factor": one.k,
        "expanded_uncertainty": one.expanded,
        "identification": {"standard_uncertainty": own if math.isfinite(own) else None},
    }
    if budget.drawn is not None and one.index is not None:
        u, interval = float(budget.drawn.u[one.index]), list(budget.drawn.interval(one.index))
        out["monte_carlo"] = {"standard_uncertainty": u, "interval": interval}
    return out


def conformity_parts(found: Conformity) -> Iterator[Part]:
    """The decision of all tolerances together, what is suspicious, and the verdicts, one a row."""
    yield decision_words(found)
    yield from suspicion_words(found.suspicious)
    yield table(
        say("conformity.by", rule=rule_words(found)),
        found.each,
        say("conformity.by_budget" if found.uncertainty == "budget" else "conformity.nothing_decided"),
        figure=lambda one: _figure(one.name),
        tolerance=lambda one: quantity(one.tolerance, one.unit),
        measured_u=lambda one: quantity(one.value, one.unit, one.u) if math.isfinite(one.value) else NOT_DETERMINED,
        probability=lambda one: _percent(one.probability),
        decision=lambda one: named("decision", one.decision),
        why=lambda one: one.why,
    )


def rule_words(found: Conformity) -> str:
    """By what it is decided whether a tolerance is kept."""
    return say(f"conformity.{found.rule.replace('-', '_')}", level=f"{100 * found.level:g} %")


def decision_words(found: Conformity) -> str:
    """Of all tolerances together, in a sentence."""
    key = "conformity.together" if found.uncertainty == "budget" else "conformity.together_incomplete"
    return say(key, decision=named("decision", found.decision))


def _figure(name: str) -> str:
    """What of a name a tolerance is for, which is not its values along the axis."""
    if name in ERROR_MOTIONS:
        return say(f"conformity.{'about_line' if parse_motion(name).is_straightness else 'range'}", name=name)
    return say("conformity.volumetric") if name == VOLUMETRIC else name


def _percent(probability: float) -> str:
    """Never 0 or 100 %, which no measurement proves."""
    if not math.isfinite(probability):
        return NOT_DETERMINED
    if probability < 0.001:
        return "< 0.1 %"
    return "> 99.9 %" if probability > 0.999 else f"{100 * probability:.1f} %"


def conformity_document(found: Conformity) -> dict[str, Any]:
    """The verdicts for programs, SI; what is not determined is None."""
    return {
        "format": "mtcal-conformity/1",
        "provenance": found.origin.document(),
        "rule": found.rule,
        "conformance_probability": found.level,
        "uncertainty": found.uncertainty,
        "decision": found.decision,
        "suspicious": list(found.suspicious),
        "figures": [
            {"standard_uncertainty" if key == "u" else key: value for key, value in vars(verdict).items()}
            for verdict in found.each
        ],
    }
