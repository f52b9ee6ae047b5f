# SPDX-License-Identifier: Apache-2.0
"""All machines of a logbook, as a text and a document."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from machine_tool_calibration.fleet.machines import Machine, Machines
from machine_tool_calibration.fleet.texts import effects_table, fleet_line, machines_table, problems_table, reasons_of
from machine_tool_calibration.interface.show import Answer
from machine_tool_calibration.reports.tables import Part


@dataclass(frozen=True, eq=False, repr=False)
class Fleet(Answer, Machines):
    """All machines of a logbook: which of them need attention and why, which effects occur where."""

    @property
    def headline(self) -> str:
        """How many machines need attention."""
        return fleet_line(self)

    def parts(self) -> Iterator[Part]:
        """Which machines need attention and why, which effects occur where, and what was not evaluated."""
        yield fleet_line(self)
        yield from filter(
            lambda table: table.rows, (machines_table(self, self.attention), effects_table(self), problems_table(self))
        )

    @cached_property
    def _document(self) -> dict[str, Any]:
        return {
            "format": "mtcal-fleet/1",
            "added": self.added,
            "sessions": sum(len(one.entries) for one in self.machines),
            "machines": [_document_of(one) for one in self.machines],
            "effects": [
                {
                    "effect": name,
                    "machines": [{"machine": one.machine, "sessions": one.sessions, **one.found} for one in where],
                }
                for name, where in self.occurrences.items()
            ],
            "problems": [{"session": label, "problem": problem} for label, problem in self.problems],
        }


def _document_of(machine: Machine) -> dict[str, Any]:
    return {
        "machine": machine.name,
        "causes": machine.causes,
        "sentences": list(reasons_of(machine)),
        "sessions": len(machine.entries),
        "first": machine.trend.dates[0],
        "last": machine.trend.dates[-1],
        "verdict": machine.diagnosis and machine.diagnosis["verdict"],
        "effects": [one["effect"] for one in machine.diagnosis["effects"]] if machine.diagnosis else [],
        "alarms": [one.name for one in machine.trend.alarms],
        "size": machine.size,
        "most_uncertain": machine.uncertain,
    }
