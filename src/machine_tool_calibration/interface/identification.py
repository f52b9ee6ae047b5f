# SPDX-License-Identifier: Apache-2.0
"""Identify a machine's errors, and what can be done with the result."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.budget import complete
from machine_tool_calibration.budget.conformity import conformity
from machine_tool_calibration.budget.contributor import contributors_of, known_contributors
from machine_tool_calibration.budget.propagate import propagate
from machine_tool_calibration.budget.published import check_names
from machine_tool_calibration.budget.tolerances import tolerance
from machine_tool_calibration.diagnosis.compare import compare, one_below_the_other, residual_table
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.diagnosis.history import Entry
from machine_tool_calibration.effects.effect import Effect as PhysicalEffect
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.interface.budget import Budget, Conformity
from machine_tool_calibration.interface.diagnosis import Comparison, Diagnosis
from machine_tool_calibration.interface.features import Features
from machine_tool_calibration.interface.map_comparison import MapComparison
from machine_tool_calibration.interface.session import Measurement, Source, load
from machine_tool_calibration.interface.show import Answer, chosen, listed, own_effects_of, require_kind, require_whole
from machine_tool_calibration.maps import error_map_from_points
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.methods.identify import JointResult, fitted_sessions
from machine_tool_calibration.methods.map_comparison import compare_fits
from machine_tool_calibration.methods.probing.features import Distribution, features, monte_carlo
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.plots.compare import draw_setups
from machine_tool_calibration.plots.pictures import figures
from machine_tool_calibration.plots.style import Figure, save
from machine_tool_calibration.progress import Progress, untold
from machine_tool_calibration.reports import result_tables as tables
from machine_tool_calibration.reports.identification import Measured, result_parts
from machine_tool_calibration.reports.quantities import quantity, rounded
from machine_tool_calibration.reports.tables import Part
from machine_tool_calibration.session.contributor import Contributor


@dataclass(frozen=True, eq=False, repr=False)
class Fit(Answer):
    """The machine's errors from one measurement, each with its uncertainty.

    Attributes:
        measurement: the readings.
        result: all that was calculated, as the package itself uses it.
        chosen: the model that was asked for, and the user's own effects, known beside the catalogue.
        history: the models from the first to this one, where it is that of a history.
    """

    measurement: Measurement
    result: Result | JointResult
    chosen: FitRequest
    history: tuple[Entry, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the physical effects in the model."""
        return self.result.effects

    @property
    def model(self) -> str:
        """Variant of the method's model, such as `free` or `rigid_body`; of several sessions each one once."""
        return self.result.model_name

    @property
    def datum(self) -> str:
        """Origin and orientation, which the data cannot fix and which were chosen, in words."""
        return str(self._document["datum"])

    @property
    def rms_residual(self) -> float:
        """Root mean square of measured minus predicted, m."""
        return self.result.rms_residual

    @property
    def reduced_chi_square(self) -> float:
        """Weighted sum of squared residuals over the degrees of freedom; 1 if model and declared uncertainty fit."""
        return self.result.joint.reduced_chi_square

    @property
    def degrees_of_freedom(self) -> int:
        """Readings minus unknowns."""
        return self.result.joint.solution.degrees_of_freedom

    @property
    def p_value(self) -> float:
        """Probability of so large a sum of squares if the model is right and the declared uncertainty too."""
        return self.result.joint.p_value

    @cached_property
    def error_map(self) -> pd.DataFrame:
        """Position errors of the functional point, actual minus commanded, one place a row; SI.

        Columns: `x y z` the place, m; `ex ey ez` the error, m; `ux uy uz` its standard uncertainty, m (an expanded
        uncertainty U, k = 2, is twice that); `determined_x determined_y determined_z`: where False, error and
        uncertainty are NaN. Step diagonals have `axis` besides, rotary axes `target` and the angle (`c`, rad). A place
        is there more than once, with the direction of `approach` (`x+ y-`), where its error depends on that, and with
        the `row` of the first reading in each state of time, temperature and the like, where it depends on those.
        """
        return tables.error_map(self.result)

    @cached_property
    def error_motions(self) -> pd.DataFrame:
        """Error motions and squareness errors named as in ISO 230-1, one value a row.

        Columns: `motion` (EXX, ECY, C0Y, …), `position` on its axis in `position_unit` (m or rad; NaN for a
        squareness), `value` and standard uncertainty `u` in `unit` (m or rad), `determined`. Without rows where each
        point has unknowns of its own instead (a tracking interferometer with the model `free`). The straightness of a
        step diagonal holds the slopes from which its squareness is read: not both are to be added up.
        """
        return tables.error_motions(self.result)

    @cached_property
    def workpiece(self) -> pd.DataFrame:
        """Errors of a probed workpiece's points by the point's id; without rows for other methods.

        Columns: nominal place `x y`, m, and outward normal `nx ny`; `error` along the normal with its standard
        uncertainty `u`, m, and `determined`; `form`, the same without what a shift and turn of the whole workpiece
        explain, `u_form`, m, and `form_determined`.
        """
        return tables.workpiece(self.result)

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """Every unknown of the model by name.

        Columns: `value` and standard uncertainty `u` in `unit` (SI), `determined`, `meaning` in words, `why_not`:
        where it is not determined value and uncertainty are NaN, and this is the reason.
        """
        return tables.parameters(self.result, self._document)

    @cached_property
    def residuals(self) -> pd.DataFrame:
        """Every reading that takes part in the fit, one a row; SI.

        Columns: `row` of the recording (from 0), `measured`, `predicted`, `residual` (measured minus predicted),
        `u_declared` (standard uncertainty), m, and the other columns as recorded, with those that `compare` has besides
        (`leverage`, `studentized`, covariates); of several sessions `session` first.
        """
        return one_below_the_other(self.measurement.labels, [residual_table(fit) for fit in self.result.joint.fits])

    @cached_property
    def rejected(self) -> pd.DataFrame:
        """Readings that were kept out of the fit.

        Columns: `row` of the recording (from 0), `reason`, and `deviation` from what all others predict, m, of those
        that were set aside; of several sessions `session` first.
        """
        several = [] if isinstance(self.result, Result) else ["session"]
        return pd.DataFrame(self._document["rejected"], columns=[*several, "row", "reason", "deviation"])

    def error_at(self, position: npt.ArrayLike) -> tuple[Array, Array]:
        """Position error anywhere in what was measured, by linear interpolation of the map.

        Args:
            position: (3,) or (n, 3) commanded x, y, z, m.

        Returns:
            Error, and its standard uncertainty, two arrays of the same shape, m; NaN outside of what was measured and
            in a direction that is not determined.

        Raises:
            CalibrationError: not such positions, or the map has no points.
        """
        found = self.result.error_map
        error, u = error_map_from_points(found.points, found.error, found.uncertainty)(position)
        for j, known in enumerate(np.isfinite(found.error).T):
            if known.any() and not known.all():  # runs along several axes: each is known along itself
                own = error_map_from_points(found.points[known], found.error[known], found.uncertainty[known])(position)
                error[..., j], u[..., j] = own[0][..., j], own[1][..., j]
        return error, u

    @property
    def headline(self) -> str:
        """What it is, in one line."""
        count = self.result.joint.assembly.problem.n_readings
        added = f" with {', '.join(self.effects)}" if self.effects else ""
        return (
            f"{self.measurement.method.replace('_', ' ')}, model {self.model}{added}: {count} readings, "
            f"residual {quantity(self.rms_residual, 'm')} RMS, reduced chi-square {rounded(self.reduced_chi_square)}"
        )

    def parts(self) -> Iterator[Part]:
        """What `mtcal identify` prints: how well it fits, errors with uncertainty, what is not determined."""
        return result_parts(self._document, self.measurement.sessions, self.result)

    @property
    def pictures(self) -> tuple[str, ...]:
        """Names of the pictures that `plot` draws."""
        return tuple(self._figures())

    def plot(self, picture: str | None = None) -> Figure:
        """One of the pictures of `mtcal identify --plot`.

        Args:
            picture: one of `pictures`; the first of the method if absent.

        Returns:
            A figure that no window shows; a notebook does, and `savefig` writes it.

        Raises:
            CalibrationError: there is none of that name.
        """
        return chosen(self._figures(), picture)

    def save_pictures(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write all of them as PNG files into a folder, each with what it was made from at its foot."""
        require_kind(folder, str | os.PathLike, "folder must be a path")
        return save(self._figures(), Path(folder), self.result.provenance)

    def features(
        self,
        *,
        named: Mapping[str, Sequence[str]] | None = None,
        centres: Mapping[str, Sequence[str]] | None = None,
        frame: tuple[str, str] | None = None,
        distances: Sequence[tuple[str, str]] = (),
        angles: Sequence[tuple[str, ...]] = (),
        draws: int = 0,
        distribution: Distribution = "normal",
        seed: int = 1,
    ) -> Features:
        """Pins, holes, spheres and walls of a probed part, distances and angles between them.

        Args:
            named: ids of the points of features that the session's points do not name.
            centres: further features, each the circle or line through the centres of several: names, or patterns such
                as `pin*`.
            frame: the feature that has no error, and the one that gives the direction; without, the part as a whole
                has no shift and no turn.
            distances: pairs of features.
            angles: pairs of walls, or three round features: the angle at the second.
            draws: for a check by Monte Carlo (GUM Supplement 1), at least 100; none if 0.
            distribution: of the touches' errors in the draws: normal, rectangular or triangular.
            seed: of the draws.

        Raises:
            CalibrationError: no probing session, several sessions, no such feature, or features that do not fit.
        """
        require_whole(draws=draws, seed=seed)
        if not isinstance(self.result, Result):
            raise ModelError("features are those of one probing session; this fit is of several")
        if frame is not None and len(listed("frame", frame, str, " of two names")) != 2:
            raise ModelError(f"frame has {len(frame)} names, not 2")
        distances, angles = listed("distances", distances), listed("angles", angles)
        for entry in (*distances, *angles):
            listed("an entry of distances or angles", entry, str, " of names")
        fit = self.result.fit
        found = features(fit, named=named, centres=centres, frame=frame, distances=distances, angles=angles)
        drawn = monte_carlo(fit, found.rows, draws, distribution, seed) if draws else None
        return Features.of(found, drawn=drawn, origin=self.result.provenance)

    def compare(self) -> Comparison:
        """Hold the model against the readings of the fit: how well it fits, and where it fails."""
        return Comparison(compare(self.result))

    def compare_map(
        self, other: Fit, labels: tuple[str, str] = ("first", "second"), *, seed: int = 1, progress: Progress = untold
    ) -> MapComparison:
        """Hold the map against that of another measurement of the same machine, independent of this one.

        Args:
            other: of any method.
            labels: names of both.
            seed: of the draws by which the uncertainties are carried over to a common datum.
            progress: told what is done, and which share of it.

        Raises:
            CalibrationError: the maps have no point, or no direction at any, in common.
        """
        require_whole(seed=seed)
        require_kind(other, Fit, "the other map must be that of a fit, as identify gives it")
        if len(listed("labels", labels, str, " of two names")) != 2:
            raise ModelError(f"labels must be two names, not {len(tuple(labels))}")
        pair = fitted_sessions(self.result), fitted_sessions(other.result)
        found = compare_fits(*pair, labels, seed=seed, progress=progress)
        return MapComparison.of(found, origins=tuple(one.provenance for one in pair))

    def diagnose(self) -> Diagnosis:
        """Look for physical effects that the model lacks, among those of the catalogue and the user's own.

        Raises:
            ModelError: the data does not allow the model.
        """
        return Diagnosis.of(diagnose(self.chosen))

    def add(self, effects: str | PhysicalEffect | Sequence[str | PhysicalEffect]) -> Fit:
        """The same measurement with further effects in the model.

        Args:
            effects: ids, as `diagnosis.effects` gives them, or effects of the user's own.

        Raises:
            ModelError: an effect is unknown, in the model already, or needs what was not recorded.
        """
        ids, own = split_effects(effects, self.chosen.own)
        return fitted(self.measurement, replace(self.chosen.adding(ids), own=own))

    def budget(
        self,
        contributors: str | Path | Sequence[Path | Contributor | Mapping[str, Any]] | None = None,
        *,
        quantities: str | Sequence[str] = (),
        draws: int = 0,
        seed: int = 1,
        progress: Progress = untold,
    ) -> Budget:
        """Who contributes what to the uncertainty of everything that was identified.

        Args:
            contributors: a YAML file, or several and lines as mappings; those of the sessions, else of
                their instruments to begin with, if absent.
            quantities: names to tell in detail, such as EXX, C0Y or an unknown; the usual ones if absent.
            draws: of a Monte Carlo check (JCGM 101); 0 without one.
            seed: of random draws.
            progress: told what is done, and which share of it.

        Raises:
            CalibrationError: the file or a line is wrong, the instrument has no budget to begin with, or a quantity is
                not published.
        """
        require_whole(draws=draws, seed=seed)
        own = fitted_sessions(self.result)
        if not isinstance(contributors, str | Path | None):
            contributors = listed("contributors", contributors)
        if not (lines := contributors_of(contributors, self.measurement.sessions)):
            raise ModelError("contributors has 0 entries, not at least 1")
        names = listed("quantities", quantities)
        check_names(own, names)
        return Budget.of(propagate(own, lines, draws=draws, seed=seed, progress=progress), names=names)

    def conformity(
        self,
        tolerances: Mapping[str, float | str],
        *,
        rule: str = "guarded",
        level: float = 0.95,
        budget: Budget | None = None,
        seed: int = 1,
        progress: Progress = untold,
    ) -> Conformity:
        """Whether tolerances are kept: pass, fail or undecided with the probability.

        Args:
            tolerances: by figure, m or rad or a text with its unit: an error motion (its range), a squareness (its
                absolute value), A, R, E, M, B or B_mean of ISO 230-2 (`A_X` of one axis), or `volumetric`.
            rule: guarded (ISO 14253-1), guarded-acceptance, guarded-rejection or simple (JCGM 106).
            level: conformance probability of the rule.
            budget: whose uncertainties are taken; if absent that of the sessions or of their instruments to begin
                with, and where there is none, nothing passes or fails.
            seed: of random draws.
            progress: told what is done, and which share of it.

        Raises:
            CalibrationError: nothing of that name has a tolerance, a wrong unit, or no such rule.
        """
        require_whole(seed=seed)
        require_kind(tolerances, Mapping, "tolerances must be a mapping from figures to their tolerances")
        if budget is not None:
            require_kind(budget, Budget, "budget must be one, as Fit.budget gives it")
        require_kind(level, int | float, "level must be a number")
        sizes = {str(name): tolerance(str(name), size) for name, size in tolerances.items()}
        own = fitted_sessions(self.result)
        if budget is None and (lines := known_contributors(self.measurement.sessions)[0]):
            budget = self.budget(lines, seed=seed, progress=progress)
        found = conformity(own, sizes, rule=rule, level=level, budget=budget, seed=seed, progress=progress)
        return Conformity.of(found)

    @cached_property
    def _document(self) -> dict[str, Any]:
        return Measured(self.measurement.sessions, self.chosen, self.history).document(self.result)

    def _figures(self) -> dict[str, Figure]:
        return figures(self.measurement.sessions, self._document) | {"residuals": draw_setups(compare(self.result))}


def identify(
    session: Source | Sequence[Source],
    *,
    model: str | None = None,
    effects: str | PhysicalEffect | Sequence[str | PhysicalEffect] = (),
    own: Sequence[PhysicalEffect] = (),
    keep_all: bool = False,
) -> Fit:
    """Identify the machine's errors from one session, or from several of the same machine together.

    Args:
        session: what `load` gave, or whatever `load` takes.
        model: variant of the method's model, such as `free` or `rigid_body`; the method's default if absent.
        effects: physical effects to add to the model: ids, or effects of the user's own.
        own: effects of the user's own that `diagnose` shall look for beside the catalogue.
        keep_all: use all readings, also those that stand out of all others.

    Raises:
        SessionError: a session cannot be read.
        ModelError: the data does not allow the model, an effect is unknown or needs what was not recorded, or what is
            identified cannot be.
    """
    ids, known = split_effects(effects, own)
    measurement = load(session)
    return fitted(measurement, FitRequest(measurement.sessions, measurement.labels, model, ids, known, keep_all))


def fitted(measurement: Measurement, asked: FitRequest, history: tuple[Entry, ...] = ()) -> Fit:
    """What is asked for, identified; of a history with the models on the way to it."""
    return Fit(measurement, complete.identify(asked), asked, history)


def split_effects(
    effects: str | PhysicalEffect | Sequence[str | PhysicalEffect], own: Sequence[PhysicalEffect]
) -> tuple[tuple[str, ...], tuple[PhysicalEffect, ...]]:
    """Ids of effects, and the user's own: those known already (`own`) and those that are among the effects."""
    given = (effects,) if isinstance(effects, PhysicalEffect) else listed("effects", effects)
    known = {one.id: one for one in (*own_effects_of(own), *given) if isinstance(one, PhysicalEffect)}
    return tuple(e.id if isinstance(e, PhysicalEffect) else str(e) for e in given), tuple(known.values())
