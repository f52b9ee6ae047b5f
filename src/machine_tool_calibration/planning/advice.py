# SPDX-License-Identifier: Apache-2.0
"""Advice on what to measure next."""

from __future__ import annotations

from dataclasses import dataclass

from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.planning.dominant import Dominant

__all__ = ["ALIKE", "Advice", "Separation", "Visibility", "alias_groups_of"]

ALIKE = 0.9
"""Cosine from which two effects count as confounded."""


@dataclass(frozen=True)
class Separation:
    """How to distinguish confounded effects.

    Attributes:
        effects: the group, the most probable first.
        kind: of the measurement; None if none of those tried does it.
        measure: what to measure, in words.
        cosine_before: largest cosine between the first and the others now.
        cosine_after: the same with the further measurement.
        apart_before: least norm by which the readings differ between the first effect, at its fitted size, and the
            nearest of the others, in standard uncertainties, now.
        apart_after: the same with the further measurement.
        seconds: its time at the session's own pace; None without a time column.
        aside: what comes on top of that time, in words.
    """

    effects: tuple[str, ...]
    kind: str | None
    measure: str
    cosine_before: float
    cosine_after: float
    apart_before: float
    apart_after: float
    seconds: float | None
    aside: str = ""

    @property
    def separates(self) -> bool:
        """Whether they would no longer look alike."""
        return self.kind is not None and self.cosine_after < ALIKE


@dataclass(frozen=True)
class Visibility:
    """How to see an effect that hardly shows, or not at all.

    Attributes:
        effect: its id.
        coefficient: the name of that coefficient which is seen best.
        unit: its unit.
        before: its smallest detectable size now; None if the model absorbs it.
        after: the same with the further measurement.
        kind: of the measurement.
        measure: what to measure, in words.
        seconds: its time.
        aside: what comes on top of it, in words.
    """

    effect: str
    coefficient: str
    unit: str
    before: float | None
    after: float
    kind: str
    measure: str
    seconds: float | None
    aside: str = ""


@dataclass(frozen=True)
class Advice:
    """What to measure next.

    Attributes:
        separations: to distinguish confounded effects.
        visibilities: to see effects that hardly show.
        dominant: what dominates the map's uncertainty, and what makes it smaller; None where there is no map.
    """

    separations: tuple[Separation, ...] = ()
    visibilities: tuple[Visibility, ...] = ()
    dominant: Dominant | None = None


def alias_groups_of(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    """Groups of effects that this data cannot distinguish, those of the accepted effects first and led by them."""
    accepted = diagnosis.accepted
    groups = [
        tuple(sorted(group, key=lambda name: accepted.index(name) if name in accepted else len(accepted)))
        for group in diagnosis.search.groups
    ]
    return sorted(groups, key=lambda group: group[0] not in accepted)
