# SPDX-License-Identifier: Apache-2.0
"""Probing self-calibration of a free-form part on a rotary table: workpiece, X, Y and C distinguished.

The same points are touched at several angles of C. The error motions of X and Y are tables, so they stay in a closed
set however the part is turned, and can be distinguished from the part's own errors. One touch reads, along the outward
normal n at the nominal contact p of the turned workpiece (Eqs. (7) to (14)):

    displacement = G - n . (E_X, E_Y)(p) + n . (EXC, EYC) + n . (R(90 deg) p) ECC

G: error of the workpiece's surface along its normal; E_X, E_Y: position error of the linear axes, Eqs. (4)(5);
EXC, EYC, ECC: displacement and turn of the table at this index. ECC as in Eq. (13) is positive counter-clockwise about
+Z, whatever the sense in which C is commanded positive (clockwise in the paper, rotation_sign -1).

A fit says of it the workpiece and its form, the linear axes on their grid, and C.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, orthonormal_basis, root_of
from machine_tool_calibration.errors import ModelError, suspected
from machine_tool_calibration.estimation.problem import LinearPart, Part, group_points
from machine_tool_calibration.methods.build import vaguest, without_vague
from machine_tool_calibration.methods.probing import datum, geometry
from machine_tool_calibration.model.fit import Fit, fit_models
from machine_tool_calibration.model.model import Constraint, MethodModel, NotDetermined, Prior, Term, motion_value
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.result import ErrorMap, determined_values
from machine_tool_calibration.model.rigid_body import MachineTable, in_space, map_field, position_errors
from machine_tool_calibration.session.checks.mistakes import UNITS, explanation, scaled
from machine_tool_calibration.session.checks.nominal_geometry import nominal_points
from machine_tool_calibration.session.description import Probing
from machine_tool_calibration.session.judgements import Judgement
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.words import say, together

# Displacement beyond which a touch is looked at, m: no ground surface is off by so much, a casting may be.
_LARGE = 2e-4
# Median residual over the declared uncertainty: absurd, and good.
_ABSURD, _GOOD = 100.0, 30.0


def _refuse_mistakes(session: Session) -> None:
    """Refuse (ModelError) displacements that are a thousand or a million times too large."""

    def misfit(seen: Session) -> float:
        return float(np.median(np.abs(fit_models([_build(seen)]).fits[0].residuals)) / session.sigma)

    read = session.readings.displacement[np.isfinite(session.readings.displacement)]
    if not len(read) or np.median(np.abs(read)) < _LARGE:
        return
    what = explanation(session, [Judgement(misfit, scaled(session, *UNITS), _ABSURD, _GOOD)])
    if what is not None:
        with suspected():
            raise ModelError(f"{session.source}: {what}")


@dataclass(frozen=True)
class ProbingModel(MethodModel):
    """A workpiece touched at several angles of C."""

    touches: geometry.Touches  # where each touch was
    tables: tuple[MachineTable, ...]  # error motions of the linear axes, with their nodes
    grid: tuple[Array, Array]  # declared nodes of the tables of X and of Y, m: where the error map is given
    length_known: bool  # whether a measured length fixes the scale

    @property
    def description(self) -> Probing:
        """What the session says of workpiece, indices and known length."""
        return self.observations.session.description.as_a(Probing)

    def part(self, own_index: IntArray, dense_index: IntArray) -> Part:
        """Every point of the workpiece has one unknown of its own, its error along the normal; it is eliminated."""
        readings = self.observations.readings
        n = len(readings)
        return LinearPart(
            groups=group_points(self.touches.point, readings.setup),
            reading=readings.displacement,
            sigma=self.sigma,
            local=np.ones((1, n)),
            block=np.zeros((0, n)),
            dense=self.dense(),
            block_index=np.zeros((len(self.description.setups), 0), dtype=np.int64),
            dense_index=dense_index,
            n_points=len(self.description.workpiece),
        )

    def why_not_determined(self, name: str) -> str | None:
        """An angle of C at which every touch was lost."""
        at = next((p.at for p in self.parameters if p.name == name), None)
        if not isinstance(at, str):
            return None
        there = np.any(self.observations.readings.setup == self.observations.session.setup_ids.index(at))
        return None if there else say("undetermined.no_touch")


def build(session: Session, model: str = "rigid_body") -> ProbingModel:
    """The model of a probing session; a ModelError if X or Y, their known lengths or the unit are wrong."""
    if not session.description.trust_units:
        _refuse_mistakes(session)
    return _build(session)


def _build(session: Session) -> ProbingModel:
    description = session.description.as_a(Probing)
    readings = session.readings.select(np.isfinite(session.readings.displacement))
    position = readings.position()
    where = geometry.touches(description, readings, session.rotation_sign)
    observations = Observations(
        session, readings, position, -where.normal, where.normal, np.zeros(len(readings)), readings.setup
    )
    grids = {axis: geometry.table_nodes(description.machine, axis, position[:, j]) for j, axis in enumerate("XY")}
    nodes = {axis: extended for axis, (_, extended) in grids.items()}
    tables = geometry.plane_tables(description.machine.kinematics, nodes, position)
    terms = [table.term(observations) for table in tables]
    terms += _axis_c_terms(session, where, readings.setup)
    bare = ProbingModel(
        observations, tuple(terms), (), (), (), "", where, tables, (grids["X"][0], grids["Y"][0]), False
    )
    return _with_datum(bare)


def _axis_c_terms(session: Session, where: geometry.Touches, setup: IntArray) -> list[Term]:
    index = (setup == np.arange(len(session.setup_ids))[:, None]).astype(float)
    senses = {"EXC": where.normal[:, 0], "EYC": where.normal[:, 1], "ECC": where.lever}
    out = []
    for name, sense in senses.items():
        unit = "rad" if name == "ECC" else "m"
        values = (motion_value(name, setup_id, unit, shared=False) for setup_id in session.setup_ids)
        out.append(Term(name, tuple(values), index * sense))
    return out


def _with_datum(model: ProbingModel) -> ProbingModel:
    description = model.description
    names = [parameter.name for parameter in model.parameters]
    null = datum.null_space(names, model.dense(), model.touches.point, len(description.workpiece))
    wanted = datum.conditions(model.tables, [setup.id for setup in description.setups], description.known)
    places = datum.choose_places(null, wanted)
    put = [place for place in places if place is not None]
    measured, unused = _measured(model, null, put)
    # The length is a measurement with an uncertainty of its own, not an exact condition, where a touch reaches it.
    length = places[-1]
    exact = [place for place in put if not (measured and place is length)]
    why = say("undetermined.no_length")
    if unused:
        why = say("undetermined.length_untouched", names=together(unused, say("text.and")))
    return replace(
        model,
        constraints=tuple(Constraint(place.weights, place.value) for place in exact)
        + tuple(Constraint(prior.weights, prior.value) for prior in measured if prior.sigma == 0.0),
        priors=tuple(prior for prior in measured if prior.sigma > 0.0),
        left_out=() if measured else (NotDetermined(datum.LENGTH, why),),
        datum=_words(put, bool(measured)),
        length_known=bool(measured),
    )


def _measured(model: ProbingModel, null: datum.NullSpace, put: Sequence[datum.Place]) -> tuple[list[Prior], list[str]]:
    rows = np.array([null.weights(place.weights) for place in put]).reshape(-1, len(null.names))
    by_name = {table.name: table for table in model.tables}
    good, bad = [], []
    for name, entry in model.description.known.items():
        weights = datum.known_weights(by_name[name], entry.position)
        # A length at which no touch was says nothing of the lengths between the touches.
        if weights and null.fixes(rows, null.weights(weights)):
            good.append(Prior(weights, entry.value, entry.standard_uncertainty))
        else:
            bad.append(f"{name}({entry.position:.6g})")
    return good, bad


def _words(put: Sequence[datum.Place], measured: bool) -> str:
    relative = [] if measured else [say("datum.no_length")]
    form = say("datum.form" if measured else "datum.form_no_length")
    return together((together((place.words for place in put), ", "), *relative, form, say("datum.ecc")), "; ")


# Share in the undetermined directions below which a point does not take part in them.
_OPEN_SHARE = 1e-6


@dataclass(frozen=True)
class Responses:
    """The points' errors with their joint covariance, diag(own) + half @ half.T, and what leaves them open."""

    value: Array  # (N,) error of each point, m
    own: Array  # (N,) variance from the noise of its own touches, m^2
    half: Array  # (N, K) half @ half.T is the covariance from the shared unknowns, m^2
    undetermined: Array  # (N, k) change of the points with what is not determined
    scale: Array  # (N,) size of that change if nothing of it cancelled
    touched: BoolArray  # (N,) whether the point was touched

    @property
    def steady(self) -> BoolArray:
        """(N,) whether the touches determine the point's error."""
        return np.asarray(self.touched & ~_moves(self.undetermined, self.scale))

    def combine(self, rows: Array) -> tuple[Array, Array]:
        """(q,) sums of the points' errors with weights (q, N), zero of points not touched, and (q, q) their covariance.

        NaN where the touches do not determine one.
        """
        half = rows @ self.half
        covariance = (rows * self.own) @ rows.T + half @ half.T
        value = rows @ self.value
        open_ = _moves(rows @ self.undetermined, np.abs(rows) @ self.scale)
        value[open_], covariance[open_], covariance[:, open_] = np.nan, np.nan, np.nan
        return value, covariance


def _moves(undetermined: Array, scale: Array) -> BoolArray:
    """Whether each row takes part in what is not determined."""
    return np.asarray(np.linalg.norm(undetermined, axis=1) >= _OPEN_SHARE * np.where(scale > 0, scale, 1.0))


def responses(fit: Fit, point: IntArray, n_points: int) -> Responses:
    """Carry the fit over to the N points; (n,) which one each reading touched."""
    marginal = fit.joint.marginal
    columns = fit.marginal_columns
    mean, total = geometry.point_means(columns, point, fit.model.sigma**-2, n_points)
    touched = total > 0
    half = marginal.scatter * mean @ root_of(fit.marginal_covariance)
    free = np.zeros((len(columns), fit.undetermined.shape[1]))
    free[: len(fit.theta)] = np.where(fit.determined[:, None], 0.0, fit.undetermined)
    # What a point would do if the unknowns on which it depends changed one by one.
    scale = np.abs(mean) @ np.abs(free).max(axis=1, initial=0.0)
    own = marginal.scatter**2 / np.where(touched, total, np.inf)
    return Responses(marginal.solution.local[fit.index][0], own, half, mean @ free, scale, touched)


def workpiece_form(found: Responses, motion: Array) -> tuple[Array, Array]:
    """(N,) errors without what motions (N, t) of the whole workpiece explain, and (N,) standard uncertainties, m.

    By least squares, all points alike; NaN where the touches do not determine it.
    """
    used = points_of_form(found, motion)
    basis = orthonormal_basis(motion[used])
    half = found.half[used] - basis @ (basis.T @ found.half[used])
    own = found.own[used]
    taken = np.sum(basis**2, axis=1)
    inner = basis.T @ (own[:, None] * basis)
    variance = own * (1.0 - 2.0 * taken) + np.einsum("na,ab,nb->n", basis, inner, basis) + np.sum(half**2, axis=1)
    value, uncertainty = np.full(len(used), np.nan), np.full(len(used), np.nan)
    value[used] = found.value[used] - basis @ (basis.T @ found.value[used])
    uncertainty[used] = np.sqrt(np.maximum(variance, 0.0))
    return value, uncertainty


def points_of_form(found: Responses, motion: Array) -> BoolArray:
    """(N,) over which the motion (N, t) of the whole is taken out: all touched if it alone is open, else steady."""
    used = found.touched
    basis = orthonormal_basis(motion[used])
    left = found.undetermined[used] - basis @ (basis.T @ found.undetermined[used])
    return found.steady if np.any(_moves(left, found.scale[used])) else used


def common_motions(description: Probing, length_known: bool) -> Array:
    """(N, t) shift along x and y and turn of the workpiece, and its uniform growth where no length is known."""
    position, normal = nominal_points(description)
    growth = [] if length_known else [np.einsum("nd,nd->n", position, normal)]
    return np.column_stack([normal, geometry.table_lever(position, normal), *growth])


# Change with an undetermined direction of unit length below which a value does not take part in it.
_OPEN_CHANGE = 1e-6


def error_map(model: ProbingModel, fit: Fit) -> ErrorMap:
    """Collect the errors with their standard uncertainties; NaN where the touches do not determine them.

    The content holds, in the order of the session's lists: `workpiece_error`, along the outward normal, in the
    datum (position, direction and form); `workpiece_form`, the same without what a shift and turn of the whole
    workpiece explain; `position_error` of the linear axes on `grid`, X slow and Y fast, (E_X, E_Y) of Eqs. (4)(5);
    `EXC`, `EYC`, `ECC` at the indices `c`. Metres and radians.
    """
    workpiece, lost = _workpiece(model, fit)
    places = np.array([(x, y, 0.0) for x in model.grid[0] for y in model.grid[1]])
    error, covariance = _plane(model.tables, places, fit)
    error, uncertainty, covariance, vague = without_vague(fit, error, covariance)
    why = say("undetermined.vague", size=f"{1e3 * vaguest(fit):g}")
    for axis, count in zip("xy", np.sum(vague, axis=0), strict=True):
        if count:
            lost += (NotDetermined(f"position_error along {axis} of {count} of {len(places)} points", why),)
    setups = model.description.setups
    content: dict[str, Any] = {
        **workpiece,
        "grid": places[:, :2],
        "position_error": error,
        "position_error_u": uncertainty,
        "setups": [setup.id for setup in setups],
        "c": np.array([setup.c for setup in setups]),
        **_axis_c(fit, [setup.id for setup in setups]),
        "datum": model.datum,
    }
    return ErrorMap(content, places, in_space(error), in_space(uncertainty), in_space(covariance), lost)


def _workpiece(model: ProbingModel, fit: Fit) -> tuple[dict[str, Any], tuple[NotDetermined, ...]]:
    points = model.description.workpiece
    found = responses(fit, model.touches.point, len(points))
    # Errors in the datum: position, direction and form together.
    error, u = np.where(found.steady, [found.value, np.sqrt(found.own + np.sum(found.half**2, axis=1))], np.nan)
    form, form_u = workpiece_form(found, common_motions(model.description, model.length_known))
    content = {
        "workpiece_points": [point.id for point in points],
        "workpiece_error": error,
        "workpiece_error_u": u,
        "workpiece_form": form,
        "workpiece_form_u": form_u,
    }
    quarters = 2.0 / np.pi * np.diff([setup.c for setup in model.description.setups])
    alike = np.allclose(quarters, np.round(quarters), atol=1e-3)
    lost = []
    for k in np.flatnonzero(~np.isfinite(error)):
        why = say("undetermined.not_touched")
        if found.touched[k]:
            why = say(f"undetermined.touches{'_quarter_turns' if alike else ''}")
        if np.isfinite(form[k]):
            why = say("undetermined.only_form")
        lost.append(NotDetermined(f"workpiece point {points[k].id}", why))
    return content, tuple(lost)


def _plane(tables: tuple[MachineTable, ...], places: Array, fit: Fit) -> tuple[Array, Array]:
    """Position error (n, 2) of the linear axes at places (n, 3), and its covariance (n, 2, 2)."""
    field = map_field(tables, places)[:, :, :2]
    k, n, _ = field.shape
    error, covariance = position_errors(field, fit.theta[:k], fit.covariance[:k, :k])
    undetermined = np.linalg.norm(field.reshape(k, -1).T @ fit.undetermined[:k], axis=1).reshape(n, 2) > _OPEN_CHANGE
    error[undetermined] = np.nan
    covariance[undetermined] = np.nan
    covariance.transpose(0, 2, 1)[undetermined] = np.nan
    return error, covariance


def _axis_c(fit: Fit, setup_ids: list[str]) -> dict[str, Array]:
    names = [parameter.name for parameter in fit.model.parameters]
    (value, uncertainty), out = determined_values(fit), {}
    for name in ("EXC", "EYC", "ECC"):
        pick = [names.index(f"{name}({setup_id})") for setup_id in setup_ids]
        out[name], out[f"{name}_u"] = value[pick], uncertainty[pick]
    return out
