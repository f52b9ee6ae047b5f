"""The loop: diagnose, accept what is found, identify again, and see how far the error fell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.diagnosis.consequence import effect_estimates, map_change, map_rms
from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.history import Coefficient, Entry
from machine_tool_calibration.model.result import Estimate, Result
from machine_tool_calibration.session.session import Session

__all__ = ["Improvement", "Step", "entries", "improve"]


@dataclass(frozen=True)
class Step:
    """A model on the way.

    Attributes:
        change: what it has and the one before has not: an effect's id, or words.
        result: of its identification.
        map_rms: RMS length of the position errors at the map's points, m; None where the method maps none.
        map_uncertainty: RMS length of their standard uncertainty, as it is published, m.
        map_change: RMS length by which they moved against the step before, m.
        set_aside: rows of the readings that were left out.
    """

    change: str
    result: Result
    map_rms: float | None
    map_uncertainty: float | None
    map_change: float | None
    set_aside: tuple[int, ...]

    @property
    def label(self) -> str:
        """What to write beside it."""
        if not self.change:
            return "first model"
        return f"+ {self.change}" if self.change in self.result.effects else self.change

    @property
    def reduced_chi_square(self) -> float | None:
        """Weighted sum of squares over the degrees of freedom."""
        value = self.result.fit.joint.reduced_chi_square
        return value if np.isfinite(value) else None

    @property
    def unexplained_at_tool(self) -> float:
        """RMS length of what the readings saw of the tool point and the model does not explain, m; noise taken off.

        Only where the model gives the tool point's errors by the machine's: where every point is free, what is left
        are contradictions between readings of the same point.
        """
        observations = self.result.fit.model.observations
        method = observations.session.method
        if method != "direct" and (method, self.result.model_name) != ("tracking_interferometer", "rigid_body"):
            return 0.0
        beyond = max((self.reduced_chi_square or 1.0) - 1.0, 0.0) * observations.session.sigma**2
        # A reading sees one direction of as many as were looked along.
        seen = np.linalg.eigvalsh(observations.direction.T @ observations.direction / len(observations))
        return float(np.sqrt(beyond * np.sum(seen > 1e-3)))

    @property
    def left_at_tool(self) -> float | None:
        """Standard uncertainty (RMS length) left at the tool point, m.

        That of the map, times the factor by which the readings scatter more than declared, as what the model does not
        explain is taken to act on the map as noise does (an effect that the model lacks may act more); and what is
        seen at the tool point itself and not explained.
        """
        chi = self.reduced_chi_square
        if self.map_uncertainty is None or chi is None:
            return None
        more = np.sqrt(max(chi, 1.0)) / self.result.fit.scatter_factor
        return float(np.hypot(self.map_uncertainty * more, self.unexplained_at_tool))

    @property
    def parameters(self) -> tuple[Estimate, ...]:
        """Coefficients of the effects in the model."""
        return effect_estimates(self.result.fit.joint, self.result.effects)


@dataclass(frozen=True)
class Improvement:
    """A model made better.

    Attributes:
        diagnosis: of the first model.
        steps: the first model, then one for every change.
    """

    diagnosis: Diagnosis
    steps: tuple[Step, ...]

    def left_at_tool(self, step: Step) -> float | None:
        """RMS length left at the tool point with the model of a step, so that steps can be compared, m.

        The expanded uncertainty (k = 2) that the step itself knows of, and how far its map is from that of the last
        step: what a model lacks moves its map by more than its own residuals tell.
        """
        if step.left_at_tool is None:
            return None
        off = map_change(step.result.error_map, self.steps[-1].result.error_map)
        return float(np.hypot(2.0 * step.left_at_tool, off or 0.0))


def improve(
    session: Session,
    *,
    model: str | None = None,
    effects: Sequence[str] = (),
    own: Sequence[Effect] = (),
    seed: int = 1,
    sets: int = 199,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Improvement:
    """Find the missing effects, add them one after the other, and identify with each.

    Nothing is added unless the diagnosis names it as the cause; readings that it sets aside are left out first.

    Args:
        session: the measurement.
        model: the method's model; its default if absent.
        effects: ids of effects that are in the first model already.
        own: the user's own effects.
        seed: of the simulated data sets.
        sets: simulated data sets in which nothing is missing.
        progress: told what is being done and the share that is finished.

    Raises:
        ModelError: the data does not allow the model.
    """
    found = diagnose(
        session,
        model=model,
        effects=effects,
        own=own,
        seed=seed,
        sets=sets,
        progress=lambda what, share: progress(what, 0.9 * share),
    )
    aside = tuple(sorted(outlier.row for outlier in found.outliers))
    steps = [_step(None, "", identify(session, model=model, effects=effects, own=own, keep_all=True), ())]
    if aside:
        words = f"{len(aside)} reading{'' if len(aside) == 1 else 's'} set aside"
        result = identify(found.session, model=model, effects=effects, own=own, keep_all=True)
        steps.append(_step(steps[-1], words, result, aside))
    for k, name in enumerate(found.accepted):
        progress(f"adding {name}", 0.9 + 0.1 * k / len(found.accepted))
        added = [*effects, *found.accepted[: k + 1]]
        result = identify(found.session, model=model, effects=added, own=own, keep_all=True)
        steps.append(_step(steps[-1], name, result, aside))
    progress("done", 1.0)
    return Improvement(found, tuple(steps))


def _step(before: Step | None, change: str, result: Result, aside: tuple[int, ...]) -> Step:
    return Step(
        change=change,
        result=result,
        map_rms=map_rms(result.error_map.error),
        map_uncertainty=map_rms(result.error_map.uncertainty),
        map_change=None if before is None else map_change(before.result.error_map, result.error_map),
        set_aside=aside,
    )


def entries(improvement: Improvement, data: str, made: str, by: str) -> list[Entry]:
    """The steps as entries of a history.

    Args:
        improvement: what was done.
        data: fingerprint of the readings.
        made: date and time, ISO 8601.
        by: the command.
    """
    out: list[Entry] = []
    for step in improvement.steps:
        joint = step.result.fit.joint
        p_value = joint.p_value
        out.append(
            Entry(
                number=len(out) + 1,
                made=made,
                by=by,
                model=step.result.model_name,
                effects=step.result.effects,
                change=step.change,
                data=data,
                used=len(step.result.fit.model.observations),
                set_aside=step.set_aside,
                rms_residual=step.result.rms_residual,
                reduced_chi_square=step.reduced_chi_square,
                degrees_of_freedom=joint.solution.degrees_of_freedom,
                p_value=p_value if np.isfinite(p_value) else None,
                map_rms=step.map_rms,
                map_uncertainty_rms=step.map_uncertainty,
                map_change_rms=step.map_change,
                parameters=tuple(
                    Coefficient(name=p.name, value=p.value, standard_uncertainty=p.standard_uncertainty, unit=p.unit)
                    for p in step.parameters
                ),
            )
        )
    return out
