# SPDX-License-Identifier: Apache-2.0
"""What is told before and while something is measured: forecasts, the best plan, what is enough, what comes next."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from machine_tool_calibration.budget.enough import Reached
from machine_tool_calibration.coverage import K
from machine_tool_calibration.json_types import plain
from machine_tool_calibration.machine.error_motions import ERROR_MOTIONS, parse_motion
from machine_tool_calibration.planning.best_plan import BestPlan
from machine_tool_calibration.planning.dominant import Dominant
from machine_tool_calibration.planning.forecast import Forecast
from machine_tool_calibration.planning.outlook import Outlook
from machine_tool_calibration.reports.identification import group_by_reason
from machine_tool_calibration.reports.quantities import duration, expanded_text, micrometres, probability, quantity
from machine_tool_calibration.reports.tables import Part, TextTable, heads, table
from machine_tool_calibration.words import named, say


def dominant_words(found: Dominant) -> Iterator[str]:
    """Sentences; where the scatter of the readings dominates, only more of them help, and nothing is proposed.

    In shares: what U is, the map says, and the sizes assumed here are no part of that.
    """
    if found.cause == "readings":
        yield say("found.dominant_readings", share=f"{100 * found.shares['readings']:.0f}")
        return
    share = f"{100 * found.shares[found.cause]:.0f}"
    if found.cause == "time":
        yield say("found.dominant_time", share=share, size=quantity(found.drift, "m/s"))
    else:
        yield say("found.dominant", share=share, size=quantity(found.angular, "rad"))
    for remedy in found.remedies:
        measure: str = remedy.measure
        if remedy.seconds is not None:
            key = "found.remedy_besides" if remedy.aside else "found.remedy_time"
            measure = say(key, measure=measure, time=duration(remedy.seconds), besides=remedy.aside)
        ends = remedy.uncertainty, found.again
        left, again = (None if u is None else f"{100 * u / found.uncertainty:.0f}" for u in ends)
        key = "found.remedy" if again is None else "found.remedy_again"
        yield say(key, measure=measure, share=left, again=again)
    if not found.remedies:
        yield say("found.no_remedy")


def forecast_parts(found: Forecast) -> Iterator[Part]:
    """Uncertainties to come first, then what will be missing, the smallest effects found, and what dominates."""
    document = plain(found.document())
    sigma = found.result.fit.model.observations.session.sigma
    method = named("method", document["method"].replace("_", " "))
    measured = {"n": document["readings"], "u": quantity(sigma, "m"), "time": duration(found.seconds)}
    yield say("forecast.headline", method=method, model=document["model"], **measured)
    # each coordinate by itself
    rows = [_uncertainty_row(name.removesuffix("_u"), values) for name, values in document["uncertainties"].items()]
    rows += [
        (one["name"], *2 * (expanded_text(2.0 * one["standard_uncertainty"], one["unit"]),), "")
        for one in document["squareness"]
    ]
    columns = heads("", "typical", "at_most", "not_determined")
    yield TextTable(say("forecast.uncertainty"), columns, tuple(row for row in rows if row is not None))
    for why, names in group_by_reason((entry["name"], entry["why"]) for entry in document["not_determined"]):
        yield say("forecast.undetermined", names=names, why=why)
    sizes = tuple(
        (entry.effect, f"{entry.coefficient} = {quantity(entry.size, entry.unit)}", micrometres(entry.reading))
        for entry in found.visible
    )
    if sizes:
        yield TextTable(say("forecast.sizes"), heads("effect", "size", "reading_change_um"), sizes)
    if found.absorbed:
        yield say("forecast.absorbed", names=", ".join(found.absorbed))
    if found.dominant is not None:
        yield from dominant_words(found.dominant)
    yield say("result.datum", datum=document["datum"])


def _uncertainty_row(name: str, values: Any) -> tuple[str, str, str, str] | None:
    """RMS and largest expanded uncertainty of an entry of the map."""
    if not isinstance(values, list) or not np.size(values):
        return None
    found = np.array(values, dtype=float).ravel()
    good = np.isfinite(found)
    lost = say("text.of", n=int((~good).sum()), count=len(found)) if not good.all() else ""
    if not good.any():
        return name, "–", "–", lost
    unit = "rad" if name in ERROR_MOTIONS and parse_motion(name).is_rotation else "m"
    typical, most = 2 * float(np.sqrt(np.mean(found[good] ** 2))), 2 * float(found[good].max())
    return name.replace("_", " "), expanded_text(typical, unit), expanded_text(most, unit), lost


def best_plan_parts(found: BestPlan) -> Iterator[Part]:
    """What was chosen, what it determines beside the procedure as it stands, and how much better a plan could be."""
    setups, targets = found.candidates
    yield say("best_plan.searched", plans=found.tried, setups=setups, targets=targets)
    if found.stopped:
        yield say("best_plan.stopped")
    elif found.tried == 1:
        yield say("best_plan.no_choice")
    of = say("best_plan.of_effects", names=", ".join(found.effects)) if found.effects else say("best_plan.of_map")
    yield table(
        say("best_plan.title", of=of),
        {"present": found.present, "best": found.best}.items(),
        "" if found.effects else say("best_plan.complete" if found.complete else "best_plan.readings_only"),
        plan=lambda one: say(f"best_plan.{one[0]}"),
        setups=lambda one: ", ".join(one[1].setups),
        targets=lambda one: ", ".join(one[1].targets),
        repeats=lambda one: str(one[1].repeats),
        time=lambda one: duration(one[1].seconds),
        U_largest=lambda one: _plan_u(found, one[1].largest),
        typical=lambda one: _plan_u(found, one[1].typical),
    )
    before, after = found.present.largest, found.best.largest
    change: str = ""
    if np.isfinite(before):
        less = 100.0 * (1.0 - after / before)
        kind = "as_good" if found.best is found.present else "smaller" if less >= 0.0 else "larger"
        change = say(f"best_plan.{kind}", percent=f"{abs(less):.0f}")
    if found.bound > 0.0:
        least = _plan_u(found, found.bound)
        if not np.isfinite(before):
            change += say("best_plan.bound", least=least)
        else:
            percent = f"{100.0 * (1.0 - found.bound / before):.0f}"
            change = f"{change}; {say('best_plan.bound_percent', least=least, percent=percent)}"
    if change:
        yield change


def _plan_u(found: BestPlan, u: float) -> str:
    if found.effects and np.isfinite(u):
        return f"{200.0 * u:.2g} %"
    return expanded_text(K * u)


def reached_parts(stages: Sequence[Reached]) -> Iterator[Part]:
    """A row for each setup, as it was left, and after which of them it was enough."""
    effects = list(dict.fromkeys(name for one in stages for name in one.probabilities))
    rows = tuple(
        (
            one.setup,
            str(one.readings),
            duration(one.seconds),
            *([] if effects else [expanded_text(one.u)]),
            *(probability(one.probabilities.get(name)) for name in effects),
        )
        for *_, one in (group for _, group in groupby(stages, key=lambda one: one.setup))
    )
    columns = (*heads("setup", "readings", "time"), *(effects or heads("U_largest")))
    yield TextTable(say("enough.title"), columns, rows, "" if effects else say("enough.coordinate"))
    if (first := next((one for one in stages if one.enough), None)) is None:
        yield say("enough.never")
    else:
        yield say("enough.after", setup=first.setup, time=duration(first.seconds))


def outlook_table(every: Sequence[Outlook]) -> TextTable:
    """One row for what is known now and one for each further measurement."""
    return table(
        say("outlook.title"),
        every,
        say("outlook.note"),
        measure=lambda one: one.words or say("outlook.known"),
        readings=lambda one: str(len(one.session.readings)) if one.words else "",
        time=lambda one: duration(one.seconds) if one.words else "",
        besides=lambda one: one.aside,
        U_map_rms=lambda one: expanded_text(K * one.typical),
        at_most_coordinate=lambda one: expanded_text(K * one.largest),
    )
