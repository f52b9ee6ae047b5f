# SPDX-License-Identifier: Apache-2.0
"""The model of a step diagonal's session and its map: errors of the axes, tilts of the mirrors, offsets of runs."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.estimation.marginal import noise_variance
from machine_tool_calibration.estimation.problem import Part
from machine_tool_calibration.machine.error_motions import interpolation, parse_motion
from machine_tool_calibration.methods.build import linear_part
from machine_tool_calibration.methods.iso230_2 import diagonal_tests
from machine_tool_calibration.methods.step_diagonal import small_angles
from machine_tool_calibration.methods.step_diagonal.geometry import Run
from machine_tool_calibration.methods.step_diagonal.profiles import Profiles, eq17, is_open
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import MethodModel, NotDetermined, Parameter, Term, weight_row
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.model.rigid_body import MachineTable, map_field
from machine_tool_calibration.words import say, together

DATUM = say("datum.step_diagonal")


@dataclass(frozen=True)
class Spread:
    """Angular errors as small random functions."""

    tables: tuple[MachineTable, ...]  # the nine angular error motions
    terms: tuple[Term, ...]  # with unknowns of the session's own
    posterior: small_angles.AngularPosterior | None = None  # what the readings say of them; None before it is settled

    @property
    def size(self) -> float:
        """Root mean square of the angles over the travel, over all sizes that the readings leave possible, rad."""
        return 0.0 if self.posterior is None else self.posterior.size

    @property
    def nodes(self) -> tuple[tuple[Array, int], ...]:
        """For each its nodes, m, and the index of the one at which it is zero."""
        return tuple((table.nodes, 0) for table in self.tables)

    @property
    def names(self) -> list[list[str]]:
        """Names of their unknowns."""
        return [[parameter.name for parameter in term.parameters] for term in self.terms]


@dataclass(frozen=True)
class StepDiagonalModel(MethodModel):
    """Readings of a flat mirror's displacement along a few diagonals and axes."""

    runs: tuple[Run, ...]  # the setups
    blocks: tuple[Array, Array, Array]  # block positions of x, y, z, m
    tables: tuple[MachineTable, ...]  # position errors of the axes and squareness, the first terms of the model
    angles: tuple[MachineTable, ...]  # angular errors that are free unknowns
    # angular errors as small random functions; None where the model takes them to be zero or free
    spread: Spread | None
    nominal: Array  # (n,) reading with all unknowns zero, m
    # the zero of every run (setup and repeat): its first reading, from which it counts, has an error too
    offsets: tuple[Parameter, ...]

    @property
    def own(self) -> tuple[Parameter, ...]:
        """The offset of every run."""
        return self.offsets

    def part(self, own_index: IntArray, dense_index: IntArray) -> Part:
        """All columns are known beforehand."""
        seen = self.observations
        reading = seen.readings.displacement - self.nominal
        return linear_part(self, seen.run, reading, np.ones((1, len(seen))), own_index.reshape(-1, 1), dense_index)

    def reestimated(self) -> Self:
        """The size of the angular errors estimated again, with the terms that were added."""
        if self.spread is None:
            return self
        random = {term.name for term in self.spread.terms}
        plain = replace(self, terms=tuple(term for term in self.terms if term.name not in random))
        place = {parameter.name: k for k, parameter in enumerate(plain.parameters)}
        rows = [weight_row(place, constraint.weights, len(place)) for constraint in self.constraints]
        offsets = (self.observations.run == np.arange(len(self.offsets))[:, None]).astype(float)
        columns = np.concatenate([offsets, plain.dense(), *(term.columns for term in self.spread.terms)]) / self.sigma
        measured = (self.observations.readings.displacement - self.nominal) / self.sigma
        # Readings that scatter more than declared even with free angles are no angles.
        unit = columns / np.maximum(np.linalg.norm(columns, axis=1, keepdims=True), np.finfo(float).tiny)
        best, _, rank, _ = np.linalg.lstsq(unit.T, measured)
        left = measured - best @ unit
        variance = np.maximum(noise_variance(left @ left, len(left) - rank), 1.0)
        gram, right = columns @ columns.T / variance, columns @ measured / variance
        posterior = small_angles.normal_posterior(self.spread.nodes, gram, right, np.array(rows))
        spread = replace(self.spread, posterior=posterior)
        return replace(self, spread=spread, priors=small_angles.angular_priors(spread.names, posterior.priors))

    def drawn_as(self, other: Self) -> Self:
        """With the size of the angular errors of a model of other readings, and their noise."""
        drawn = super().drawn_as(other)
        if self.spread is None or other.spread is None or self.spread.names != other.spread.names:
            return drawn
        return replace(drawn, spread=replace(self.spread, posterior=other.spread.posterior), priors=other.priors)

    def expecting(self, size: float) -> Self:
        """The model with angular errors of that root mean square, rad, whatever the readings say of them."""
        if self.spread is None:
            return self
        expected = [size**2 * small_angles.mean_shape(*where) for where in self.spread.nodes]
        spread = replace(self.spread, posterior=None)
        return replace(self, spread=spread, priors=small_angles.angular_priors(spread.names, expected))

    @property
    def random(self) -> small_angles.SmallAngles | None:
        """Small angles: what is published is the mean over all their sizes and shapes that are possible."""
        if self.spread is None or self.spread.posterior is None:
            return None
        names = tuple(label for labels in self.spread.names for label in labels)
        return small_angles.SmallAngles(names, self.spread.nodes, self.spread.posterior.ratios)

    @property
    def edges(self) -> Array:
        """(n, 3) block positions along the edges that meet in the first ones, axis after axis, m."""
        corner = np.array([nodes[0] for nodes in self.blocks])
        each = (np.where(np.arange(3) == axis, nodes[:, None], corner) for axis, nodes in enumerate(self.blocks))
        return np.concatenate(list(each))

    def _map_rows(self) -> tuple[Array, IntArray]:
        """(K, M) position errors at the block positions per unit of unknowns, and (K,) places of these in the model.

        Angular errors count by their lever arms along the edges that meet in the first block positions.
        """
        tables = [*self.tables, *self.angles]
        names = [label for table in tables for label in table.labels]
        if self.spread is not None:
            tables += self.spread.tables
            names += [label for labels in self.spread.names for label in labels]
        field = map_field(tables, self.edges)
        place = {p.name: k for k, p in enumerate(self.parameters)}
        index = np.array([place[name] for name in names], dtype=np.int64)
        return field.reshape(len(field), -1), index

    def _oriented(self, rows: Array, undetermined: Array) -> tuple[Array, str]:
        """(M, K) rows of the map in the coordinate system of Eq. (17), and in words what orients it in another way.

        The last block positions orient it; where that leaves a part of the map open in the directions
        `undetermined` (K, k), those before them with which the least is.
        """
        last = (-1, -1, -1)
        moved, every = undetermined.T @ rows, np.eye(rows.shape[1])

        def lost(last: tuple[int, int, int]) -> int:
            return int(is_open(every, eq17(self.blocks, moved, last).T).sum())

        least = lost(last) if moved.size else 0
        axes = (0, 0, 2 if len(self.blocks[2]) > 1 else 1)
        for number, axis in enumerate(axes if least else ()):
            for at in range(len(self.blocks[axis]) - 2, 0, -1):
                x_y, x_z, z_y = (at if k == number else one for k, one in enumerate(last))
                count = lost((x_y, x_z, z_y))
                if count < least:
                    last, least = (x_y, x_z, z_y), count
        names = ("e_y(x)", "e_z(x)", "e_y(z)" if axes[2] == 2 else "e_z(y)")
        words = [
            say("datum.zero_at", name=name, place=f"{1e3 * self.blocks[axis][at]:g}")
            for name, axis, at in zip(names, axes, last, strict=True)
            if at != -1
        ]
        return eq17(self.blocks, rows, last).T, together(words, ", ")

    def _there(self) -> Array:
        """(M,) whether the model holds a value for each of the map's entries: 1, or NaN."""
        out = []
        tables = {table.name: table for table in self.tables}
        for axis, nodes in zip("XYZ", self.blocks, strict=True):
            there = np.full((len(nodes), 3), np.nan)
            for j, component in enumerate("XYZ"):
                if (table := tables.get(f"E{component}{axis}")) is not None:
                    there[np.isin(np.round(nodes, 9), np.round(table.nodes, 9)), j] = 1.0
            out.append(there.ravel())
        return np.concatenate(out)

    def profiles(self, fit: Fit) -> Profiles:
        """Position errors at the block positions in the coordinate system of Eq. (17), with their covariance."""
        error, mine = self._map_rows()
        rows, oriented = self._oriented(error, fit.undetermined[mine])
        # A direction's entries are of mixed units: what matters is what it does to the map.
        moved = rows @ fit.undetermined[mine]
        value = rows @ fit.theta[mine] * self._there()
        covariance = rows @ fit.covariance[np.ix_(mine, mine)] @ rows.T
        return Profiles(self.blocks, value, covariance, moved, oriented)


def error_map(model: StepDiagonalModel, fit: Fit) -> ErrorMap:
    """Position errors of each axis at its block positions, straightness and squareness."""
    profiles = model.profiles(fit)
    content: dict[str, Any] = {}
    for letter, nodes, error, u in zip("xyz", model.blocks, profiles.error, profiles.uncertainty, strict=True):
        content |= {letter: error, f"{letter}_u": u, f"{letter}_position": nodes}
    figures = profiles.figures()
    for kind in ("positioning", "straightness", "squareness"):
        own = [figure for figure in figures if figure.kind == kind]
        content[kind] = {key: v for f in own for key, v in ((f.name, f.value), (f"{f.name}_u", f.uncertainty))}
    content |= _angular(model, fit)
    told = fit.joint.marginal.random
    if told is not None:
        content["angular_size"] = told.size
        content["angular_probability"] = told.probability
    if fit.joint.given is None:  # of the readings themselves: a refit changes nothing of them
        content |= diagonal_tests(model.observations)
    content["datum"] = model.datum
    if profiles.oriented:
        content["datum"] = say("datum.oriented", own=model.datum, what=profiles.oriented)
    points = model.edges
    error, uncertainty = np.concatenate(profiles.error), np.concatenate(profiles.uncertainty)
    n = len(points)
    blocks = profiles.covariance.reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n), :]
    known = np.isfinite(error)
    blocks = np.where(known[:, :, None] & known[:, None, :], blocks, np.nan)
    measured = profiles.split(profiles.value)
    lost = tuple(
        NotDetermined(f"error_map.{letter}: e{component}", _why(model, values[:, j], part[:, j]))
        for letter, values, part in zip("xyz", measured, profiles.error, strict=True)
        for j, component in enumerate("xyz")
        if not np.isfinite(part[:, j]).all() and len(part) > 1
    )
    return ErrorMap(content, points, error, uncertainty, blocks, lost)


def _angular(model: StepDiagonalModel, fit: Fit) -> dict[str, Any]:
    """Free angular errors at the block positions: x_angular … (N + 1, 3) EA, EB, EC with `_u`."""
    if not model.angles:
        return {}
    place = {p.name: k for k, p in enumerate(model.parameters)}
    out: dict[str, Any] = {}
    for axis, letter in enumerate("xyz"):
        nodes = model.blocks[axis]
        value, uncertainty = np.full((len(nodes), 3), np.nan), np.full((len(nodes), 3), np.nan)
        for table in model.angles:
            motion = parse_motion(table.name)
            at = [place[label] for label in table.labels]
            if motion.axis != letter.upper() or not fit.determined[at].all():
                continue
            weights = interpolation(table.nodes, nodes)
            column = "ABC".index(motion.component)
            value[:, column] = weights.T @ fit.theta[at]
            square = np.einsum("kn,kl,ln->n", weights, fit.covariance[np.ix_(at, at)], weights)
            uncertainty[:, column] = np.sqrt(np.maximum(square, 0.0))
        out[f"{letter}_angular"], out[f"{letter}_angular_u"] = value, uncertainty
    return out


def _why(model: StepDiagonalModel, measured: Array, determined: Array) -> str:
    """Why a column of the map has gaps: values that were measured, and values that are determined."""
    missing = int(np.count_nonzero(~np.isfinite(measured)))
    if missing == np.count_nonzero(~np.isfinite(determined)):
        return say("undetermined.not_reached", n=missing, count=len(measured))
    present = [model.runs[k] for k in np.unique(model.observations.readings.setup)]
    diagonals = {run.sign.tobytes() for run in present if run.diagonal}
    moved = [axis for axis, nodes in enumerate(model.blocks) if len(nodes) > 1]
    linear = [axis for axis in moved if not any(run.sign[axis] and not run.diagonal for run in present)]
    lacking = [say("undetermined.no_linear_run", axis="XYZ"[axis]) for axis in linear]
    if len(diagonals) < len(moved):
        lacking.insert(0, say("undetermined.diagonals", n=len(diagonals), count=len(moved)))
    return say("undetermined.runs", lacking=together(lacking or [say("undetermined.too_few")], ", "))
