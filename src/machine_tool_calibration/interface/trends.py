# SPDX-License-Identifier: Apache-2.0
"""One machine over months, as a text, a picture and a document."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from machine_tool_calibration.interface.show import Answer, notebook
from machine_tool_calibration.methods.map_comparison import LEVEL
from machine_tool_calibration.plots.style import Figure
from machine_tool_calibration.plots.trend import draw_trend
from machine_tool_calibration.reports.documents import picked
from machine_tool_calibration.reports.tables import Part
from machine_tool_calibration.reports.trends import check_remarks, check_table, check_verdict, trend_table, trend_words
from machine_tool_calibration.trends.check import Check as Checked
from machine_tool_calibration.trends.trend import ALARM, Course
from machine_tool_calibration.trends.trend import Trend as Followed


@dataclass(frozen=True, eq=False, repr=False)
class Check(Answer, Checked):
    """Whether an earlier map still predicts a measurement."""

    @property
    def headline(self) -> str:
        """The verdict, in one line."""
        return check_verdict(self)

    def parts(self) -> Iterator[Part]:
        """What changed, the verdict, and what could not be told."""
        yield check_table(self)
        yield check_verdict(self)
        yield from check_remarks(self)

    @cached_property
    def _document(self) -> dict[str, Any]:
        return {
            "format": "mtcal-check/1",
            "map": self.earlier,
            "measurement": self.now,
            **picked(self, "since", "until", "holds", "scatter", "contradicted"),  # holds: None is open
            "verdict": check_verdict(self),
            "level": LEVEL,
            "rule": "holm",
            "correlated": self.correlated,
            "sessions_of_spread": self.sessions,
            "moved": [one.name for one in self.moved],
            "open": [one.name for one in self.open],
            "too_uncertain": [one.name for one in self.blind],
            "not_compared": self.not_compared,
            "changes": [
                asdict(one) | {"moved": one.moved, "open": one.open, "too_uncertain": one.blind} for one in self.changes
            ],
        }


@dataclass(frozen=True, eq=False, repr=False)
class Trend(Answer, Followed):
    """The sizes of a machine's errors over time."""

    @property
    def headline(self) -> str:
        """What has changed."""
        return " ".join(trend_words(self))

    def parts(self) -> Iterator[Part]:
        """The sizes, how each is explained, and what has changed."""
        yield trend_table(self)
        yield from trend_words(self)

    def plot(self) -> Figure:
        """The sizes over time with U, those that changed first."""
        return notebook(draw_trend(self))

    @cached_property
    def _document(self) -> dict[str, Any]:
        return {
            "format": "mtcal-trend/1",
            "machine": self.machine,
            "dates": self.dates,
            "alarm_from": ALARM,
            "alarms": [one.name for one in self.alarms],
            "sentences": list(trend_words(self)),
            "courses": [_course(one) for one in self.courses],
        }


def _course(one: Course) -> dict[str, Any]:
    told = picked(one, "name", "unit", "kind", "alarm", "suspected", "limit", "against_limit", "dates", "value")
    if one.explanation is not None:
        told |= picked(one.explanation, "jump", "drift", "change", "u", "spread")
        told |= {"began": list(one.began), "instrument": one.explanation.shift}
        told |= {"temperature": one.explanation.warm}
        told |= picked(one.explanation, "per_kelvin", "u_per_kelvin")
        told |= {"instrument_step": one.explanation.step, "instrument_step_u": one.explanation.u_step}
    return told | {"value_u": one.u, "instruments": [one.ways[way] for way in one.way]}
