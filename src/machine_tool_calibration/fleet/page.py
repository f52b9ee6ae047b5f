# SPDX-License-Identifier: Apache-2.0
"""The page of the fleet: one HTML file that holds all it needs."""

import datetime
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from machine_tool_calibration.fleet.machines import Machines
from machine_tool_calibration.fleet.picture import draw_fleet
from machine_tool_calibration.fleet.texts import effects_table, fleet_line, machines_table, problems_table, states_table
from machine_tool_calibration.plots.trend import draw_trend
from machine_tool_calibration.report.figures import Picture
from machine_tool_calibration.report.page import rendered, save
from machine_tool_calibration.report.sections import Block, Section, in_language
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.session.provenance import SOFTWARE
from machine_tool_calibration.version import __version__
from machine_tool_calibration.words import Verbatim, Words, say

# Machines whose changes are drawn, and numbers of each.
_DRAWN, _NUMBERS = 12, 3


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
        for_paper=False,
        drawings="",
        library="",
    )
    return save(file, text)


def _attention(fleet: Machines) -> Iterator[Block]:
    if not fleet.machines:
        return
    yield Picture("overview", say("fleet.figure_overview"), draw_fleet(fleet))
    yield _untitled(machines_table(fleet, fleet.attention))
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
