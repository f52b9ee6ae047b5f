# SPDX-License-Identifier: Apache-2.0
"""What a controller's files would leave of a machine's errors, as a table."""

from machine_tool_calibration.coverage import K
from machine_tool_calibration.export.compensation import Exported
from machine_tool_calibration.reports.quantities import micrometres, quantity
from machine_tool_calibration.reports.tables import TextTable, table
from machine_tool_calibration.words import Said, say, together


def left_table(found: Exported) -> TextTable:
    """Errors before and after in each direction, and their length."""
    return table(
        say("compensation.table"),
        found.left,
        say("compensation.left_complete" if found.complete else "compensation.left"),
        direction=lambda row: row.name,
        rms_now=lambda row: micrometres(row.rms_now),
        rms_left=lambda row: micrometres(row.rms_left),
        largest_now=lambda row: micrometres(row.largest_now),
        largest_left=lambda row: micrometres(row.largest_left),
        U_rms=lambda row: micrometres(K * row.uncertainty),
    )


def harm_words(found: Exported) -> str:
    """That files do harm, and where, by the numbers of the table; empty if they do none."""
    if found.worse:
        return say("compensation.grow")
    grown = [_grown(one.name.upper(), one.rms_now, one.rms_left) for one in found.worse_along]
    names = {one: one.name if one is found.left[-1] else one.name.upper() for one in found.left if one.larger}
    larger = [_grown(name, one.largest_now, one.largest_left) for one, name in names.items()]
    told = [(key, of) for key, of in (("worse", grown), ("larger", larger)) if of]
    return together([say(f"compensation.{key}", n=len(of), names=together(of, ", ")) for key, of in told], "; ")


def _grown(name: str, before: float, after: float) -> Said:
    return say("compensation.grown", name=name, before=quantity(before, "m"), after=quantity(after, "m"))


def absent_words(found: Exported) -> str:
    """What the files do not hold; empty if they hold all."""
    return say("compensation.absent", names=", ".join(found.absent)) if found.absent else ""
