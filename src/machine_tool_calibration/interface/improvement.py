# SPDX-License-Identifier: Apache-2.0
"""A model made better step by step, and the error that falls."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import pandas as pd

from machine_tool_calibration.budget import complete
from machine_tool_calibration.diagnosis.improve import Improvement as Done
from machine_tool_calibration.diagnosis.improve import Step
from machine_tool_calibration.effects.effect import Effect as PhysicalEffect
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.interface.diagnosis import Diagnosis
from machine_tool_calibration.interface.identification import Fit, split_effects
from machine_tool_calibration.interface.session import Measurement, Source, load
from machine_tool_calibration.interface.show import Answer, notebook
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.plots.diagnosis import draw_improvement, draw_steps, residuals_by_reading, step_table
from machine_tool_calibration.plots.style import Figure
from machine_tool_calibration.reports.improvement import improvement_document, improvement_parts
from machine_tool_calibration.reports.quantities import micrometres
from machine_tool_calibration.reports.tables import Part
from machine_tool_calibration.residuals.noise import noise_of


@dataclass(frozen=True, eq=False, repr=False)
class Improvement(Answer, Done):
    """The models on the way from the first one to the best.

    Attributes:
        diagnosis: of the first model.
        further: of the models with what was found, as long as these left something.
        measurement: the readings.
    """

    diagnosis: Diagnosis
    further: tuple[Diagnosis, ...]
    measurement: Measurement

    @classmethod
    def of(cls, found: Done, **more: Any) -> Self:
        """As `Answer.of`, the diagnosis too."""
        looks = tuple(map(Diagnosis.of, found.further))
        return super().of(replace(found, diagnosis=Diagnosis.of(found.diagnosis), further=looks), **more)

    @cached_property
    def fits(self) -> tuple[Fit, ...]:
        """Every model, the first one, the one without readings that do not belong to the rest, one for each effect."""
        used = [replace(self.measurement, sessions=step.chosen.sessions) for step in self.steps]
        return tuple(Fit(own, step.result, step.chosen) for own, step in zip(used, self.steps, strict=True))

    @property
    def best(self) -> Fit:
        """The last model. Where look-alikes of its effects move the map differently, its uncertainty contains that."""
        return self.fits[-1]

    @property
    def history(self) -> pd.DataFrame:
        """The error step by step, one model a row; SI, root mean squares.

        Columns: `change` against the row before, `effects` in the model, `readings` used, `rms_residual` (m),
        `reduced_chi_square`, and of the position errors `map_rms` (m), `map_change_rms` (m, against the row before),
        `map_uncertainty_rms` and `left_at_tool_rms` (standard uncertainties, m); NaN where the method maps none.
        """
        table = step_table(self)
        numbers = [name for name in table if name not in ("change", "effects", "readings")]
        return table.astype(dict.fromkeys(numbers, float))

    @property
    def residuals(self) -> pd.DataFrame:
        """Every reading with `residual_before` and `residual_after` (m; NaN where it was set aside)."""
        return residuals_by_reading(self)

    @property
    def headline(self) -> str:
        """What was added and how far the residual fell, in one line."""
        first, last = self.steps[0].result, self.steps[-1].result
        added = self.accepted
        return (
            f"{'added ' + ', '.join(added) if added else 'nothing added'}; residual "
            f"{micrometres(first.rms_residual)} → {micrometres(last.rms_residual)} µm RMS"
        )

    def parts(self) -> Iterator[Part]:
        """What `mtcal improve` prints: a row for every step, before and after side by side."""
        return improvement_parts(self)

    def plot(self) -> Figure:
        """The picture of `mtcal improve`: the error falling, and the residuals before and after."""
        return notebook(draw_improvement(self))

    _document = cached_property(improvement_document)


def improve(
    session: Source | Sequence[Source],
    *,
    model: str | None = None,
    effects: str | PhysicalEffect | Sequence[str | PhysicalEffect] = (),
    own: Sequence[PhysicalEffect] = (),
) -> Improvement:
    """Find the missing effects, add them one after the other, identify with each, and look again.

    As `mtcal improve` does, without writing a history. Nothing is added unless the diagnosis names it as the cause;
    readings that do not belong to the rest are left out first.

    Arguments and errors are those of `identify`, the model and its effects those that it begins with.
    """
    measurement = load(session)
    ids, known = split_effects(effects, own)
    asked = FitRequest(measurement.sessions, measurement.labels, model, ids, known)
    return Improvement.of(complete.improve(asked), measurement=measurement)


def plot_improvement(fits: Sequence[Fit]) -> Figure:
    """The error falling from one model to the next, and the residuals of the first and the last one.

    Args:
        fits: of the same measurement, in the order in which they are to be drawn.

    Returns:
        A figure that no window shows; a notebook does, and `savefig` writes it.

    Raises:
        CalibrationError: no fits, something else, or fits of different measurements.
    """
    models = tuple(fits) if isinstance(fits, list | tuple) else (fits,)
    if not models or not all(isinstance(fit, Fit) for fit in models):
        raise CalibrationError("an improvement is drawn of a list of fits, as `identify` and `add` give them")
    described = [[session.description for session in fit.measurement.sessions] for fit in models]
    if any(own != described[0] for own in described):
        raise CalibrationError("an improvement is drawn of fits of the same measurement")
    steps = list[Step]()
    for fit in models:
        before = steps[-1] if steps else None
        added = [name for name in fit.effects if before and name not in before.result.effects]
        change = (" + ".join(added) or f"model {fit.model}") if before else ""
        steps.append(Step(before, change, fit.chosen, fit.result, tuple(() for _ in fit.chosen.sessions)))
    return notebook(draw_steps(steps, noise_of(models[0].result.joint.fits[0]).declared))
