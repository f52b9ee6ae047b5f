# SPDX-License-Identifier: Apache-2.0
"""Where a model fails, and which physical effect it lacks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pandas as pd

from machine_tool_calibration.budget.complete import Conclusions, conclude
from machine_tool_calibration.diagnosis.compare import Comparison as OneComparison
from machine_tool_calibration.diagnosis.compare import JointComparison, one_below_the_other
from machine_tool_calibration.diagnosis.diagnose import Diagnosis as Found
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.interface.show import Answer, chosen, listed, notebook, printed
from machine_tool_calibration.plots.compare import draw_setups, figures
from machine_tool_calibration.plots.diagnosis import candidate_table, draw_diagnosis
from machine_tool_calibration.plots.style import Figure
from machine_tool_calibration.reports.comparison import comparison_document, comparison_parts
from machine_tool_calibration.reports.diagnosis import diagnosis_parts
from machine_tool_calibration.reports.diagnosis_document import diagnosis_document
from machine_tool_calibration.reports.tables import Part
from machine_tool_calibration.reports.verdict import verdict_line


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Answer):
    """A model held against its readings: how well it fits, and where it fails.

    Attributes:
        found: all that was calculated, of one session or of several.
    """

    found: OneComparison | JointComparison

    @property
    def residuals(self) -> pd.DataFrame:
        """Every reading with what was predicted and every covariate, as `comparison.csv` of `mtcal compare`; SI.

        Columns: `row` (from 0), `setup`, `repeat`, `measured`, `predicted`, `residual` (m), `studentized` (residual
        over its own standard uncertainty; NaN where the model has a reading for itself), and all that was recorded.
        """
        return self.found.residuals

    @property
    def setups(self) -> pd.DataFrame:
        """Each setup, worst first.

        Columns: `name`, `readings`, `rms` (m), `reduced_chi_square`, `share` of the whole sum of squares, `mean`
        residual (m) and `slope` over time (m/s) with standard uncertainties `mean_u` and `slope_u`; NaN where the
        model takes it up; `worst_row`, the reading with the largest studentized residual. Several sessions have
        `session` besides.
        """
        return self.found.setups

    @property
    def regions(self) -> pd.DataFrame:
        """Bins of each axis.

        Columns: `axis`, from `low` to `high` (m or rad), and those of `setups`.
        """
        return self._of_each("regions")

    @property
    def approaches(self) -> pd.DataFrame:
        """What the residuals of the two directions of approach of an axis differ by.

        Columns: `axis`, readings `forward` and `backward`, mean `difference` (m), `displacement` of the axis that it
        stands for (m or rad; minus twice the half width of a backlash), each with its standard uncertainty `_u`,
        `p_value`; NaN where the model takes it up.
        """
        return self._of_each("approaches")

    @property
    def trends(self) -> pd.DataFrame:
        """How the residuals change with each covariate, the most significant first.

        Columns: `covariate`, its `span`, `slope` of the residuals (m per unit) and `added`, the slope that the model
        would find, each with its standard uncertainty `_u`, `p_value`; NaN where the model takes it up.
        """
        return self._of_each("trends")

    @property
    def worst(self) -> pd.DataFrame:
        """Readings with the largest studentized residuals; columns as of `residuals`."""
        return self.found.worst

    @property
    def headline(self) -> str:
        """How well the model fits, in one line."""
        return str(self._document["summary"])

    def parts(self) -> Iterator[Part]:
        """What `mtcal compare` prints: by setup and repeat, region, direction of approach, over covariates."""
        return comparison_parts(self.found)

    def plot(self, picture: str = "residuals", *, against: Sequence[str] = (), session: str | None = None) -> Figure:
        """One of the pictures of `mtcal compare`.

        Args:
            picture: `residuals` (over covariates), `measured_predicted`, `residual_map` or `setups`.
            against: covariates for `residuals`; the first of their ranking if empty.
            session: of several sessions, the label of the one to draw; the first one if absent.

        Raises:
            CalibrationError: no such picture, covariate or session.
        """
        one = self.found
        if isinstance(one, JointComparison):
            if picture == "setups" and session is None:
                return notebook(draw_setups(one))
            labels = one.labels
            if session is not None and session not in labels:
                raise CalibrationError(f"no session {session!r}; there are {', '.join(labels)}")
            one = one.sessions[0 if session is None else labels.index(session)]
        against = listed("against", against)
        for name in against:
            one.covariate(name)
        return chosen(figures(one, against), picture)

    @cached_property
    def _document(self) -> dict[str, Any]:
        return comparison_document(self.found)

    def _of_each(self, table: str) -> pd.DataFrame:
        return one_below_the_other(self.found.labels or (), [getattr(one, table) for one in self.found.sessions])


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Answer, Found):
    """Which physical effects a model lacks, how sure that is, and what to measure to be surer.

    Attributes:
        concluded: what follows from it, where that is worked out already.
    """

    concluded: Conclusions | None = None

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the effects that are missing, the surest first, as `fit.add` takes them; empty where none is named."""
        return self.accepted

    @property
    def probability(self) -> pd.Series[float]:
        """Probability that each effect is missing, by its id, the most probable first."""
        ranked = {finding.name: finding.probability for finding in self.ranked if finding.rank}
        return pd.Series(ranked, name="probability", dtype=float).rename_axis("effect")

    @cached_property
    def candidates(self) -> pd.DataFrame:
        """Every effect that was looked for, by its id, the most probable first; SI.

        Columns: `probability`, `p_value` (largest chance of so much evidence if nothing is missing), `delta_bic`,
        `plausible` (whether such a size occurs), `rms_before` and `rms_after` of the residuals (m), `map_change_rms`
        (m; NaN where it was not worked out).
        """
        return candidate_table(self, self.conclusions.changes).set_index("effect")

    @property
    def outliers(self) -> pd.DataFrame:
        """Readings that were set aside.

        Columns: `row` of the recording, `studentized`, `deviation` (m); of several sessions `session` first.
        """
        labels = self.chosen.labels
        rows = [
            (label, outlier.row, outlier.studentized, outlier.deviation)
            for label, own in zip(labels or ("",), self.set_aside, strict=True)
            for outlier in own
        ]
        table = pd.DataFrame(rows, columns=["session", "row", "studentized", "deviation"])
        return table if labels else table.drop(columns="session")

    @cached_property
    def conclusions(self) -> Conclusions:
        """What each candidate would change, and what to measure next; worked out when it is first asked for."""
        return self.concluded or conclude(self)

    @property
    def headline(self) -> str:
        """The verdict in one line."""
        return verdict_line(self)

    def parts(self, *, details: bool = False) -> Iterator[Part]:
        """What `mtcal diagnose` prints: the verdict, the effects and the next step.

        Args:
            details: with every effect that was looked for, confounded effects, what to measure next and what is
                hidden, as with `--details`.
        """
        return diagnosis_parts(self, self.conclusions, details=details)

    def report(self, *, details: bool = False) -> str:
        """The same as text."""
        return printed(self.parts(details=details))

    def plot(self) -> Figure:
        """The picture of `mtcal diagnose`: probabilities, what adding the effects does, what the residuals follow."""
        return notebook(draw_diagnosis(self, self.conclusions.changes))

    @cached_property
    def _document(self) -> dict[str, Any]:
        return diagnosis_document(self, self.conclusions.advice, self.conclusions.changes)
