# SPDX-License-Identifier: Apache-2.0
"""From contributors to the uncertainty of everything that is published.

Numerically, as GUM 5.1.3, Note 2, has it: the readings that share a value of a contributor are shifted by one standard
uncertainty of it, the same fit is made of them, and what a published number changes by is the contribution; the values
of a contributor are independent, so that their contributions add in squares. Where every reading has a value of its own
of the size for which the fit weighs it, the covariance of the fit is that sum in closed form. Second order contributors
(across the beam, angle) shift all readings by their mean, besides, which is not zero.

Figures of ISO 230-2 and ISO 230-6 are largest values and ranges of the readings, which a shift one way may change by
more than one the other way, or a larger one by more than in proportion: they are shifted by ten equally probable
values, and the mean square counts. What differs from reading to reading or run to run is in what the runs scatter.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from machine_tool_calibration.arrays import Array, BoolArray
from machine_tool_calibration.budget.patterns import Pattern, pattern
from machine_tool_calibration.budget.published import Numbers, Quantity, everything, iso_numbers, numbers
from machine_tool_calibration.coverage import COVERAGE
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.reduction import single_blas
from machine_tool_calibration.methods.fitted import FittedSessions
from machine_tool_calibration.model.fit import changed, covariance_of, declared
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.session.contributor import Contributor
from machine_tool_calibration.session.provenance import Provenance
from machine_tool_calibration.words import say

KNOWN = "known besides the readings"
"""Line for what the fit itself takes for known with an uncertainty, such as positions of stations or a length."""
REPEATABILITY = "repeatability of the runs"
"""Line for what the runs of an ISO 230-2 measurement scatter, which the figures hold already."""

# Values of a contributor that are shifted one after the other; of more, so many random draws are taken instead.
_MOST_GROUPS = 100
DRAWS = 200
# Part of the declared uncertainty below which an upper bound of what a contributor does is enough.
_NEGLIGIBLE_SHARE = 0.01
_MOST_NUMBERS = 100_000_000  # numbers that all draws of a check may have
_ALIKE = 1e-9
# Equally probable values of the standard normal distribution, of unit mean square.
_VALUES = special.ndtri((np.arange(10) + 0.5) / 10.0)
_VALUES /= np.sqrt(np.mean(_VALUES**2))


@dataclass(frozen=True)
class Line:
    """What one contributor does."""

    name: str  # of the contributor
    contributor: Contributor | None  # None for `KNOWN` and `REPEATABILITY`, which the measurement brings with it
    # largest standard uncertainty of one reading from it, m; NaN where it does not enter by the readings
    reading: float
    u: Array  # (M,) standard uncertainty of each published number from it
    # `closed form`, `steps` (one value after the other), `draws` (many values at random), or `bound`: at most so much,
    # which is next to nothing
    how: str

    @property
    def degrees_of_freedom(self) -> float:
        """Of its standard uncertainty; infinite where nothing is said."""
        told = self.contributor and self.contributor.degrees_of_freedom
        return told or np.inf


@dataclass(frozen=True)
class Drawn:
    """A Monte Carlo propagation (JCGM 101)."""

    deviation: Array  # (N, M) of each published number from its value

    @property
    def u(self) -> Array:
        """(M,) root mean square deviation."""
        return np.asarray(np.sqrt(np.mean(self.deviation**2, axis=0)))

    def interval(self, index: int) -> tuple[float, float]:
        """Ends of the probabilistically symmetric coverage interval of a number's deviation, for 95 %."""
        low, high = np.percentile(self.deviation[:, index], [2.5, 97.5])
        return float(low), float(high)


@dataclass(frozen=True)
class Share:
    """A contributor's part in one number: its standard uncertainty, and this squared over the sum of all squares."""

    u: float
    share: float


@dataclass(frozen=True)
class Sum:
    """One published number's budget."""

    quantity: Quantity  # whose number it is
    index: int | None  # place of the number in the vector; None for the root mean square of all of a quantity
    shares: tuple[Share, ...]  # of the lines, in their order
    u: float  # combined standard uncertainty
    degrees_of_freedom: float  # effective ones, by Welch and Satterthwaite; infinite where nothing is said of them
    k: float  # coverage factor for 95.45 %
    u_identification: float  # standard uncertainty that the identification states

    @property
    def expanded(self) -> float:
        """Expanded uncertainty that is stated, as of `Budget.complete`."""
        return self.k * max(self.u, self.u_identification)

    @property
    def where(self) -> str:
        """Of which of the quantity's numbers; empty where there is only one."""
        return say("budget.rms") if self.index is None else self.quantity.where(self.index - self.quantity.first)


@dataclass(frozen=True)
class Budget:
    """The uncertainty of everything that is published, from its contributors."""

    numbers: Numbers  # as the identification publishes them, with its own uncertainties
    lines: tuple[Line, ...]  # the contributors
    origin: Provenance  # what it was made from
    drawn: Drawn | None = None  # a Monte Carlo check; None if there was none

    @cached_property
    def u(self) -> Array:
        """(M,) combined standard uncertainty of each published number; NaN where it is not determined."""
        total = np.sqrt(np.sum([line.u**2 for line in self.lines], axis=0))
        return np.where(np.isfinite(self.numbers.value), total, np.nan)

    @cached_property
    def complete(self) -> Array:
        """(M,) standard uncertainty that is stated: the combined one, or what the readings show where that is more."""
        return np.maximum(self.u, self.numbers.u)

    @cached_property
    def expanded(self) -> Array:
        """(M,) expanded uncertainty that is stated, for 95.45 %."""
        return coverage_factor(self.degrees_of_freedom) * self.complete

    @cached_property
    def degrees_of_freedom(self) -> Array:
        """(M,) effective ones of each combined uncertainty, by Welch and Satterthwaite (GUM Eq. (G.2b))."""
        return _effective(np.array([line.u**2 for line in self.lines]), self.lines)

    def largest(self, name: str) -> Sum | None:
        """A quantity's number of largest combined uncertainty, or None if none is determined; raises as `rms`."""
        quantity = self.numbers.quantity(name)
        own = self.u[quantity.members]
        if not np.isfinite(own).any():
            return None
        index = quantity.first + int(np.nanargmax(own))
        return self._sum(quantity, index, [line.u[index] for line in self.lines], self.numbers.u[index])

    def rms(self, name: str) -> Sum | None:
        """RMS over a quantity's numbers that are determined; None if none is. A ModelError: not published."""
        quantity = self.numbers.quantity(name)
        known = quantity.first + np.flatnonzero(np.isfinite(self.u[quantity.members]))
        if not len(known):
            return None
        parts = [float(np.sqrt(np.mean(line.u[known] ** 2))) for line in self.lines]
        return self._sum(quantity, None, parts, float(np.sqrt(np.mean(self.numbers.u[known] ** 2))))

    def _sum(self, quantity: Quantity, index: int | None, parts: Sequence[float], u_identification: float) -> Sum:
        squares = np.array(parts) ** 2
        total = float(squares.sum())
        shares = tuple(Share(float(p), float(s / total) if total else 0.0) for p, s in zip(parts, squares, strict=True))
        dof = float(_effective(squares[:, None], self.lines)[0])
        k = float(coverage_factor(np.array(dof)))
        return Sum(quantity, index, shares, float(np.sqrt(total)), dof, k, float(u_identification))


def coverage_factor(dof: Array) -> Array:
    """Of an interval of 95.45 % by Student's t; 2 for infinitely many degrees of freedom."""
    t = special.stdtrit(np.where(np.isinf(dof), 1.0, dof), 0.5 + COVERAGE / 2.0)
    return np.where(np.isinf(dof), 2.0, t)


def _effective(squares: Array, lines: Sequence[Line]) -> Array:
    """(M,) effective degrees of freedom of sums of squares (lines, M); infinite where nothing is said of them."""
    own = np.array([line.degrees_of_freedom for line in lines])
    weight = np.sum(squares**2 / own[:, None], axis=0)
    return np.where(weight > 0, squares.sum(axis=0) ** 2 / np.where(weight > 0, weight, 1.0), np.inf)


@single_blas()
def propagate(
    fitted: FittedSessions,
    contributors: Sequence[Contributor],
    *,
    draws: int = 0,
    seed: int = 1,
    progress: Progress = untold,
) -> Budget:
    """The uncertainty of everything that is published, from contributors to the readings.

    With so many `draws` of a Monte Carlo check (JCGM 101) beside it; a ModelError: more than memory holds.
    """
    return _Propagation(fitted, contributors, seed, progress).budget(draws)


def draw_readings(fitted: FittedSessions, contributors: Sequence[Contributor], draws: int, seed: int) -> Drawn:
    """Deviations of everything that is published for readings that are drawn with the contributors' values, linear."""
    return _Propagation(fitted, contributors, seed, untold).drawn(draws, again=False)


class _Propagation:
    """What is worked out once for all contributors."""

    def __init__(
        self, fitted: FittedSessions, contributors: Sequence[Contributor], seed: int, progress: Progress
    ) -> None:
        self.fitted, self.joint, self.progress = fitted, fitted.joint, progress
        self.rng = np.random.default_rng(seed)
        models = self.joint.assembly.models
        self.ends = np.cumsum([len(model.observations) for model in models])
        self.sigma = np.concatenate([model.sigma for model in models])
        self.patterns = [pattern(c, [model.observations for model in models]) for c in contributors]
        priors = self.joint.assembly.problem.priors
        self.known = np.zeros(0) if priors is None else priors.sigma
        self.points = any(part.dimension for part in self.joint.assembly.problem.parts)
        self.published = everything(fitted)
        count = sum(q.count for q in self.published.quantities if q.figure is not None)
        self.iso = slice(len(self.published.value) - count, len(self.published.value))
        self.repeatability = np.zeros(len(self.published.value))
        self.repeatability[self.iso] = np.nan_to_num(self.published.u[self.iso])
        self.base = self.values(np.zeros(len(self.sigma)))

    def split(self, shift: Array) -> list[Array]:
        """Of all readings, those of each session."""
        return np.split(shift, self.ends[:-1])

    def values(
        self, shift: Array, known: Array | None = None, *, again: bool = False, of_figures: Array | None = None
    ) -> Array:
        """(M,) what is published when something is added to the readings, for figures of ISO 230-2 something else."""
        parts = self.split(shift)
        mapped = numbers(self.fitted, changed(self.joint, parts, known, again=again)).value
        figures = iso_numbers(self.fitted, parts if of_figures is None else self.split(of_figures))
        return np.concatenate([mapped, figures.value])

    def budget(self, draws: int) -> Budget:
        lines = []
        for k, own in enumerate(self.patterns):
            self.progress(own.contributor.name, k / len(self.patterns))
            lines.append(self.line(own))
        if np.nan_to_num(self.from_known).any():
            lines.append(Line(KNOWN, None, np.nan, self.from_known, "steps" if self.points else "closed form"))
        if self.repeatability.any():
            lines.append(Line(REPEATABILITY, None, np.nan, self.repeatability, "closed form"))
        drawn = self.drawn(draws, again=True) if draws else None
        return Budget(self.published, tuple(lines), self.fitted.provenance, drawn)

    def line(self, own: Pattern) -> Line:
        squares = np.zeros(len(self.base))
        if own.curvature.any():
            squares = (self.values(own.mean) - self.base) ** 2
        added, how = self.spread(own)
        added[self.iso] = np.where(self.shown(own), 0.0, added[self.iso])
        reading = float(np.sqrt(own.mean**2 + own.size**2).max(initial=0.0))
        return Line(own.contributor.name, own.contributor, reading, np.sqrt(squares + added), how)

    def shown(self, own: Pattern) -> BoolArray:
        """(iso,) which figures hold what a contributor does already, in the scatter of their runs."""
        return np.asarray((self.repeatability[self.iso] > 0.0) & (own.contributor.varies in ("reading", "run")))

    def spread(self, own: Pattern) -> tuple[Array, str]:
        """(M,) variance from the independent values of a contributor, and how it was worked out."""
        there = np.unique(own.group[own.size > 0])
        closed = self.closed(own) if len(there) > _MOST_GROUPS or own.contributor.varies == "reading" else None
        if closed is not None:
            return closed
        if len(there) > _MOST_GROUPS:
            return self.drawn_squares(own), "draws"
        squares = np.zeros(len(self.base))
        for g in there:
            shift = own.signed * (own.group == g)
            change = (self.values(shift) - self.base) ** 2
            if self.iso.stop > self.iso.start:
                change[self.iso] = self.of_figures(shift)
            squares += change
        return squares, "steps"

    def of_figures(self, shift: Array) -> Array:
        """(iso,) mean square change of the figures by a value of which this is one standard uncertainty."""
        shifted = (iso_numbers(self.fitted, self.split(z * shift)).value for z in _VALUES)
        return np.asarray(np.mean([(values - self.base[self.iso]) ** 2 for values in shifted], axis=0))

    def closed(self, own: Pattern) -> tuple[Array, str] | None:
        """The same from the covariance of the fit; None where that does not tell it."""
        # What readings share adds to at most so many times what they would do alone (Cauchy-Schwarz inequality), and to
        # just that where they are alike.
        size = own.size * np.sqrt(np.bincount(own.group)[own.group])
        ratio = size / self.sigma
        if own.single and float(np.ptp(ratio)) <= _ALIKE * float(ratio.max()):
            squares, how = float(ratio.max()) ** 2 * self.from_readings**2, "closed form"
        elif own.single and not self.points:
            squares, how = self.mapped(covariance_of(self.joint, self.split(size))), "closed form"
        elif ratio.max() < _NEGLIGIBLE_SHARE:
            squares, how = float(ratio.max()) ** 2 * self.from_readings**2, "bound"
        else:
            return None
        if self.iso.stop > self.iso.start:
            squares[self.iso] = self.drawn_squares(own, iso_only=True)[self.iso]
        return squares, how

    def drawn_squares(self, own: Pattern, *, iso_only: bool = False) -> Array:
        """(M,) mean square change over random values."""
        total = np.zeros(len(self.base))
        for k in range(DRAWS):
            self.progress(own.contributor.name, k / DRAWS)
            shift = own.signed * self.rng.standard_normal(own.count)[own.group]
            if iso_only:
                figures = iso_numbers(self.fitted, self.split(shift)).value
                total[self.iso] += (figures - self.base[self.iso]) ** 2 / DRAWS
            else:
                total += (self.values(shift) - self.base) ** 2 / DRAWS
        return total

    @cached_property
    def from_readings(self) -> Array:
        """(M,) standard uncertainty from the declared uncertainty of the readings."""
        total = self.squares(self.joint.solution.covariance)
        return np.sqrt(np.maximum(total - self.from_known**2, 0.0))

    @cached_property
    def fixed(self) -> Array:
        """(M,) variance that a map has without any of the unknowns: of a line through stations as they are stated."""
        return np.zeros(len(self.base)) if self.points else self.squares(np.zeros_like(self.joint.solution.covariance))

    def mapped(self, covariance: Array) -> Array:
        """(M,) variance from a covariance of the shared unknowns."""
        return np.maximum(self.squares(covariance) - self.fixed, 0.0)

    def squares(self, covariance: Array) -> Array:
        """(M,) variance as a map of this covariance states it."""
        total = np.zeros(len(self.base))
        total[: self.iso.start] = numbers(self.fitted, declared(self.joint, covariance)).u ** 2
        return total

    @cached_property
    def from_known(self) -> Array:
        """(M,) standard uncertainty from what is known besides the readings."""
        problem = self.joint.assembly.problem
        if not self.points:
            # Without points of its own a map is worked out from the covariance alone, whichever that is.
            rows = np.zeros((0, problem.size))
            if problem.priors is not None:
                rows = problem.priors.columns / problem.priors.sigma[:, None] @ self.joint.solution.covariance
            return np.sqrt(self.squares(rows.T @ rows))
        still, squares = np.zeros(len(self.sigma)), np.zeros(len(self.base))
        for k, sigma in enumerate(self.known):
            self.progress(KNOWN, k / len(self.known))
            known = sigma * (np.arange(len(self.known)) == k)
            squares += (self.values(still, known) - self.base) ** 2
        return np.sqrt(squares)

    def drawn(self, draws: int, *, again: bool) -> Drawn:
        """Everything drawn together."""
        if draws * len(self.base) > _MOST_NUMBERS:
            raise ModelError(
                f"{draws} draws of {len(self.base)} published numbers do not fit into memory; "
                f"at most {_MOST_NUMBERS // len(self.base)} draws of this measurement"
            )
        base = self.values(np.zeros(len(self.sigma)), again=True) if again else self.base
        # What no reading and no prior of the fit brings with it.
        besides = np.sqrt(self.repeatability**2 + np.nan_to_num(self.fixed))
        out = np.empty((draws, len(base)))
        for k in range(draws):
            self.progress("Monte Carlo", k / draws)
            shift, of_figures = np.zeros(len(self.sigma)), np.zeros(len(self.sigma))
            for own in self.patterns:
                change = own.change(own.contributor.draw(self.rng, own.count))
                shift += change
                of_figures += 0.0 if self.shown(own).any() else change
            known = self.known * self.rng.standard_normal(len(self.known))
            noise = besides * self.rng.standard_normal(len(base))
            out[k] = self.values(shift, known, again=again, of_figures=of_figures) - base + noise
        return Drawn(out)
