# SPDX-License-Identifier: Apache-2.0
"""The page of the fleet, one HTML file that holds all it needs, and all machines in one picture."""

import datetime
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from machine_tool_calibration.files import save
from machine_tool_calibration.fleet.fleet import effects_table, fleet_line, machines_table, problems_table, states_table
from machine_tool_calibration.fleet.machines import CAUSES, Machine, Machines
from machine_tool_calibration.plots.style import COLORS, MARKERS, NOMINAL, Axes, Figure, new_figure
from machine_tool_calibration.plots.trend import draw_trend
from machine_tool_calibration.report.figures import Picture
from machine_tool_calibration.report.page import rendered
from machine_tool_calibration.report.sections import Block, Section, in_language
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.session.provenance import SOFTWARE
from machine_tool_calibration.version import __version__
from machine_tool_calibration.words import Verbatim, Words, say

_DRAWN, _NUMBERS = 12, 3  # machines whose changes are drawn, and numbers of each


def write_page(fleet: Machines, book: Path, file: Path, words: Words) -> Path:
    """Write the page of a fleet, which is in a logbook, as an HTML file; a CalibrationError if it cannot be written."""
    parts: dict[str, list[Block]] = {
        "attention": list(_attention(fleet)),
        "effects": [_untitled(effects_table(fleet))],
        "all": [_untitled(states_table(fleet))],
        "failed": [_untitled(problems_table(fleet))],
        "provenance": [_provenance(fleet, book)],
    }
    sections = [
        Section(name, words(f"fleet.section_{name}"), [in_language(block, words) for block in blocks])
        for name, blocks in parts.items()
        if any(not isinstance(block, TextTable) or block.rows for block in blocks)
    ]
    text = rendered(
        "fleet.html",
        str(__package__),
        words=words,
        sections=sections,
        line=words.told(fleet_line(fleet)),
        software=f"{SOFTWARE} {__version__}",
        evaluated=datetime.date.today().isoformat(),
    )
    return save(file, text)


def _attention(fleet: Machines) -> Iterator[Block]:
    if not fleet.machines:
        return
    yield Picture("overview", say("fleet.figure_overview"), draw_fleet(fleet))
    yield _untitled(machines_table(fleet.attention))
    changed = [one for one in fleet.attention if one.trend.alarms]
    for machine in changed[:_DRAWN]:
        title = say("fleet.figure_trend", machine=Verbatim(machine.name))
        shown = replace(machine.trend, courses=machine.trend.alarms[:_NUMBERS])
        yield Picture(f"trend_{machine.name}", title, draw_trend(shown))


def _provenance(fleet: Machines, book: Path) -> TextTable:
    software = sorted({entry.software for one in fleet.machines for entry in one.entries})
    told = ((say("fleet.logbook"), Verbatim(book)), (say("fleet.software"), Verbatim(", ".join(software))))
    return TextTable("", ("", ""), told)


def _untitled(table: TextTable) -> TextTable:
    """A table below a heading that says the same."""
    return replace(table, title="")


# Effects that have a row of their own, and machines that have room for their names.
_EFFECTS, _NAMED = 12, 60
_LOOKS = {cause: (COLORS[k], MARKERS[k]) for cause, k in zip(CAUSES, (1, 4, 3, 0), strict=True)} | {
    "none": ("0.6", ".")
}


def draw_fleet(fleet: Machines) -> Figure:
    """Every machine's error with U (95 %), and below it the effects that its model lacks, the surer the larger."""
    effects = list(fleet.occurrences)[:_EFFECTS]
    figure = new_figure(9.5, 4.0 + 0.22 * len(effects), say("fleet.picture"))
    heights = [3.0, 0.25 * max(len(effects), 1)]
    above, *below = figure.subplots(
        2 if effects else 1, 1, sharex=True, squeeze=False, height_ratios=heights[: 1 + bool(effects)]
    )[:, 0]
    _draw_errors(above, fleet.machines)
    for panel in below:
        _draw_effects(panel, fleet, effects)
    last = below[0] if below else above
    if len(fleet.machines) <= _NAMED:
        names = [one.name for one in fleet.machines]
        last.set_xticks(range(len(names)), names, rotation=90, fontsize="x-small")
    else:
        last.set_xticks([])
        last.set_xlabel(say("fleet.axis"), fontsize="small")
    last.set_xlim(-0.7, len(fleet.machines) - 0.3)
    return figure


def _draw_errors(panel: Axes, machines: tuple[Machine, ...]) -> None:
    for cause, (color, marker) in _LOOKS.items():
        own = [(k, one.size) for k, one in enumerate(machines) if (one.causes or ("none",))[0] == cause]
        if not (shown := [(k, size) for k, size in own if size is not None]):
            continue
        panel.errorbar(
            [k for k, _ in shown], [1e6 * size.value for _, size in shown], [2e6 * size.u for _, size in shown],
            fmt=marker, color=color, ms=4, lw=0.8, label=say(f"fleet.cause_{cause}"),
        )  # fmt: skip
    panel.set_ylabel(say("picture.axis", axis=say("report.error"), unit="µm"))
    panel.set_ylim(bottom=0.0)
    panel.legend(frameon=False, fontsize="x-small", ncols=len(_LOOKS))


def _draw_effects(panel: Axes, fleet: Machines, effects: list[str]) -> None:
    places = {one.name: k for k, one in enumerate(fleet.machines)}
    for row, name in enumerate(effects):
        where = fleet.occurrences[name]
        panel.axhline(row, color=NOMINAL, lw=0.4, zorder=0)
        panel.scatter(
            [places[one.machine] for one in where], [row] * len(where),
            s=[30.0 * one.found["probability"] for one in where], color=_LOOKS["effect"][0],
        )  # fmt: skip
    panel.set_yticks(range(len(effects)), effects, fontsize="x-small")
    panel.set_ylim(len(effects) - 0.4, -0.6)
