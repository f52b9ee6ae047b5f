# SPDX-License-Identifier: Apache-2.0
"""The loop: diagnose, accept what is found, identify again, see how far the error fell, and look again.

What is found may hide something smaller, or have the wrong shape until it is fitted: so the model with it is looked at
anew, as long as it leaves something and more is found.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.diagnosis.history import Coefficient, Entry, Part
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.fitted import FitRequest, gross_errors
from machine_tool_calibration.methods.identify import JointResult, identify_sessions
from machine_tool_calibration.model.result import Estimate, Result, fit_quality, map_change, map_rms
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.residuals.gross_errors import without
from machine_tool_calibration.residuals.pool import Pool
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.provenance import Provenance
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import Said, say

# Looks at models, each with what the one before found.
_LOOKS = 4


@dataclass(frozen=True)
class Step:
    """A model on the way."""

    before: Step | None  # the model that it was made from; None for the first
    change: str  # what it has and the one before has not: an effect's id, or words
    chosen: FitRequest  # it, and the readings
    result: Result | JointResult  # of its identification
    set_aside: tuple[tuple[int, ...], ...]  # rows of the readings of each session that were left out

    @cached_property
    def map_rms(self) -> float | None:
        """RMS length of the position errors at the map's points, m; None where the method maps none."""
        return map_rms(self.result.error_map.error)

    @cached_property
    def map_uncertainty(self) -> float | None:
        """RMS length of their standard uncertainty, as it is published, m."""
        return map_rms(self.result.error_map.uncertainty)

    @cached_property
    def map_change(self) -> float | None:
        """RMS length by which those of the model alone moved against the step before, as in a diagnosis, m."""
        return None if self.before is None else map_change(self.before.result.error_map, self.result.error_map)

    @property
    def may_be(self) -> bool:
        """Whether it has the effects of the one before, and its uncertainties contain others that may be there."""
        return isinstance(self.change, Said) and self.change.key == "step.may_be"

    @property
    def label(self) -> str:
        """What to write beside it."""
        if not self.change:
            return say("step.first")
        return say("step.added", effect=self.change) if self.change in self.result.effects else self.change

    @property
    def reduced_chi_square(self) -> float | None:
        """Weighted sum of squares over the degrees of freedom."""
        value = self.result.joint.reduced_chi_square
        return value if np.isfinite(value) else None

    @property
    def unexplained_at_tool(self) -> float:
        """RMS length of what the readings saw of the tool point and the model does not explain, m; without the noise.

        Only where the model gives the tool point's errors by the machine's: where every point is free, what is left
        are contradictions between readings of the same point.
        """
        pool = Pool(self.result.joint)
        specs = {o.session.method: spec_of(o.session) for o in pool.observations}
        if len(specs) > 1 or self.result.model_name not in next(iter(specs.values())).by_axes:
            return 0.0
        beyond = max((self.reduced_chi_square or 1.0) - 1.0, 0.0) * float(np.mean(pool.sigma**2))
        # A reading sees one direction of as many as were looked along.
        direction = np.concatenate([o.direction for o in pool.observations])
        seen = np.linalg.eigvalsh(direction.T @ direction / len(direction))
        return float(np.sqrt(beyond * np.sum(seen > 1e-3)))

    @property
    def left_at_tool(self) -> float | None:
        """Standard uncertainty (RMS length) left at the tool point, m; None where the method maps no position errors.

        That of the map, times the factor by which the readings scatter more than declared, as what the model does not
        explain is assumed to act on the map as noise does (an effect that the model lacks may act more); and what is
        seen at the tool point itself and not explained.
        """
        if self.map_uncertainty is None or self.reduced_chi_square is None:
            return None
        more = max(self.result.joint.birge_ratio / self.result.joint.marginal.scatter, 1.0)
        return float(np.hypot(self.map_uncertainty * more, self.unexplained_at_tool))

    def residual_volumetric_error(self, last: Step) -> float | None:
        """RMS length left at the tool point on the way to a last model, so that steps can be compared, m.

        The expanded uncertainty (k = 2) that the step itself knows of, and how far its map is from that of the last
        step: what a model lacks moves its map by more than its own residuals show.
        """
        if self.left_at_tool is None:
            return None
        off = map_change(self.result.error_map, last.result.error_map)
        return float(np.hypot(2.0 * self.left_at_tool, off or 0.0))

    @property
    def parameters(self) -> tuple[Estimate, ...]:
        """Coefficients of the effects in the model."""
        return self.result.sizes(self.result.effects)


@dataclass(frozen=True)
class Improvement:
    """A model made better."""

    diagnosis: Diagnosis  # of the first model
    further: tuple[Diagnosis, ...]  # of the models with what was found, as long as these left something
    steps: tuple[Step, ...]  # the first model, then one for every change

    @property
    def accepted(self) -> tuple[str, ...]:
        """Effects that were found and added, in this order."""
        return tuple(name for found in self._looks for name in found.accepted)

    def probability(self, effect: str) -> float:
        """That of an effect when it was added; a ModelError if it was not."""
        if effect not in self.accepted:
            raise ModelError(f"no effect {effect!r} was added; there are {', '.join(self.accepted) or 'none'}")
        return next(found.search.of(effect).probability for found in self._looks if effect in found.accepted)

    @property
    def last(self) -> Diagnosis:
        """The last look: of the last model, or of the one before it where that left nothing to look for."""
        return self._looks[-1]

    @property
    def _looks(self) -> tuple[Diagnosis, ...]:
        return self.diagnosis, *self.further

    @property
    def provenance(self) -> Provenance:
        """What it was made from, with the last model."""
        return self.steps[-1].result.provenance


def improve(subject: Session | FitRequest, *, progress: Progress = untold) -> Improvement:
    """Find the missing effects, add them one after the other, identify with each, and look again.

    Nothing is added unless the diagnosis names it as the cause; readings that it sets aside are left out first.

    `progress` is called with what is being done and the share that is finished. A ModelError: the data does not allow
    the model.
    """
    chosen = replace(FitRequest.of(subject), keep_all=True)
    steps = [_first(chosen)]
    looks = list[Diagnosis]()
    while not looks or (len(looks) < _LOOKS and leaves_something(looks[-1])):
        # Half of what is left of the way, nine tenths of it for the search.
        left = 0.5 ** len(looks)
        found = diagnose(chosen, progress=partial(_on_the_way, progress, 1.0 - left, 0.45 * left))
        aside = tuple(tuple(sorted(outlier.row for outlier in one)) for one in found.set_aside)
        identifying = partial(_on_the_way, progress, 1.0 - 0.55 * left, 0.05 * left)
        for change, wider in accepted_models(found, identifying):
            if (aside, wider.model_of) != (steps[-1].set_aside, steps[-1].chosen.model_of):
                steps.append(Step(steps[-1], change, wider, identify_sessions(wider, found.set_aside), aside))
        looks.append(found)
        chosen = chosen.adding(found.accepted, found.alternatives)
    progress("done", 1.0)
    return Improvement(looks[0], tuple(looks[1:]), tuple(steps))


def _first(chosen: FitRequest) -> Step:
    """The model with all readings; without gross errors where these allow none."""
    try:
        return Step(None, "", chosen, identify_sessions(chosen), tuple(() for _ in chosen.sessions))
    except ModelError:
        found = gross_errors(chosen)
        if not any(own.outliers for own in found):
            raise
    chosen = replace(chosen, sessions=tuple(without(own.session, own.outliers) for own in found))
    result = identify_sessions(chosen, [own.outliers for own in found])
    change = say("step.set_aside", n=sum(len(own.outliers) for own in found))
    return Step(None, change, chosen, result, tuple(own.rows for own in found))


def leaves_something(found: Diagnosis) -> bool:
    """Whether effects were found, and the readings still scatter by more than was declared, or show a pattern."""
    return bool(found.accepted) and (fit_quality(found.fits[-1].p_value) in ("bad", "nearly") or bool(found.left))


def _on_the_way(progress: Progress, start: float, length: float, what: str, share: float) -> None:
    """Report a share of a part of the way."""
    progress(what, start + length * share)


def accepted_models(found: Diagnosis, progress: Progress) -> Iterator[tuple[str, FitRequest]]:
    """The models that a diagnosis names, each made from the one before, with what it has and that one has not.

    Without the readings that were set aside, if any; then with the effects found, one after the other, or where there
    are none, with what may be there in the uncertainty. `progress` is called with what is being done and the share that
    is finished.
    """
    start = found.chosen
    if found.gross_errors:
        yield say("step.set_aside", n=len(found.gross_errors)), start
    for k, name in enumerate(found.accepted):
        progress(f"adding {name}", k / len(found.accepted))
        yield name, start.adding(found.accepted[: k + 1], found.alternatives)
    if not found.accepted and found.alternatives:
        yield say("step.may_be"), start.adding((), found.alternatives)


def entry_of(step: Step, data: str, each: Sequence[str], made: str, by: str, *, number: int) -> Entry:
    """A step as an entry of a history, which gives it its own number.

    `data` is the fingerprint of all readings, `each` has those of each session; `made` is ISO 8601, `by` the command.
    """
    joint, used = step.result.joint, step.result.effects
    p_value, single = joint.p_value, step.result if isinstance(step.result, Result) else None
    kept = [tuple(sorted(session.sound)) for session in step.chosen.sessions]
    parts: tuple[Part, ...] = ()
    if isinstance(step.result, JointResult):
        found = zip(step.result.labels, step.result.model_names, each, step.set_aside, kept, strict=True)
        parts = tuple(
            Part(label=label, model=model, data=own, set_aside=aside, kept=sound)
            for label, model, own, aside, sound in found
        )
    return Entry(
        number=number,
        made=made,
        by=by,
        model=single.model_name if single else "joint",
        sessions=parts,
        effects=used,
        own=tuple(dict(e.definition) for e in step.chosen.own if e.id in used and e.definition is not None),
        alternatives=step.result.alternatives,
        change=step.change,
        data=data,
        used=joint.assembly.problem.n_readings,
        set_aside=step.set_aside[0] if single else (),
        kept=kept[0] if single else (),
        rms_residual=step.result.rms_residual,
        reduced_chi_square=step.reduced_chi_square,
        degrees_of_freedom=joint.solution.degrees_of_freedom,
        p_value=p_value if np.isfinite(p_value) else None,
        map_rms=step.map_rms,
        map_uncertainty_rms=step.map_uncertainty,
        map_change_rms=step.map_change,
        parameters=tuple(Coefficient(**p.document()) for p in step.parameters),
    )
