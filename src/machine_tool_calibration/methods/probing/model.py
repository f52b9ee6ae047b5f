# SPDX-License-Identifier: Apache-2.0
"""Probing self-calibration of a free-form part on a rotary table: workpiece, X, Y and C distinguished.

The same points are touched at several angles of C. The error motions of X and Y are tables, so they stay in a closed
set however the part is turned, and can be distinguished from the part's own errors. One touch reads, along the outward
normal n at the nominal contact p of the turned workpiece (Eqs. (7) to (14)):

    displacement = G - n . (E_X, E_Y)(p) + n . (EXC, EYC) + n . (R(90 deg) p) ECC

G: error of the workpiece's surface along its normal; E_X, E_Y: position error of the linear axes, Eqs. (4)(5);
EXC, EYC, ECC: displacement and turn of the table at this index. ECC as in Eq. (13) is positive counter-clockwise about
+Z, whatever the sense in which C is commanded positive (clockwise in the paper, rotation_sign -1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import ModelError, suspected
from machine_tool_calibration.estimation.problem import LinearPart, Part, group_points
from machine_tool_calibration.methods.probing.datum import (
    LENGTH,
    NullSpace,
    Place,
    choose_places,
    conditions,
    known_weights,
    null_space,
)
from machine_tool_calibration.methods.probing.geometry import Touches, plane_tables, table_nodes, touches
from machine_tool_calibration.model.fit import fit_models
from machine_tool_calibration.model.model import (
    Constraint,
    MethodModel,
    NotDetermined,
    Prior,
    Term,
    motion_value,
)
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.rigid_body import MachineTable
from machine_tool_calibration.session.checks.mistakes import UNITS, explanation, scaled
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

    touches: Touches  # where each touch was
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
    where = touches(description, readings, session.rotation_sign)
    observations = Observations(
        session, readings, position, -where.normal, where.normal, np.zeros(len(readings)), readings.setup
    )
    grids = {axis: table_nodes(description.machine, axis, position[:, j]) for j, axis in enumerate("XY")}
    nodes = {axis: extended for axis, (_, extended) in grids.items()}
    tables = plane_tables(description.machine.kinematics, nodes, position)
    terms = [table.term(observations) for table in tables]
    terms += _axis_c(session, where, readings.setup)
    bare = ProbingModel(
        observations, tuple(terms), (), (), (), "", where, tables, (grids["X"][0], grids["Y"][0]), False
    )
    return _with_datum(bare)


def _axis_c(session: Session, where: Touches, setup: IntArray) -> list[Term]:
    index = (setup == np.arange(len(session.setup_ids))[:, None]).astype(float)
    senses = {"EXC": where.normal[:, 0], "EYC": where.normal[:, 1], "ECC": where.lever}
    return [
        Term(
            name,
            tuple(
                motion_value(name, setup_id, "rad" if name == "ECC" else "m", shared=False)
                for setup_id in session.setup_ids
            ),
            index * sense,
        )
        for name, sense in senses.items()
    ]


def _with_datum(model: ProbingModel) -> ProbingModel:
    description = model.description
    names = [parameter.name for parameter in model.parameters]
    null = null_space(names, model.dense(), model.touches.point, len(description.workpiece))
    wanted = conditions(model.tables, [setup.id for setup in description.setups], description.known)
    places = choose_places(null, wanted)
    put = [place for place in places if place is not None]
    measured, unused = _measured(model, null, put)
    # The length is a measurement with an uncertainty of its own, not an exact condition, where a touch reaches it.
    length = places[-1]
    exact = [place for place in put if not (measured and place is length)]
    left_out = [] if measured else [_no_length(description, unused)]
    return replace(
        model,
        constraints=tuple(Constraint(place.weights, place.value) for place in exact)
        + tuple(Constraint(prior.weights, prior.value) for prior in measured if prior.sigma == 0.0),
        priors=tuple(prior for prior in measured if prior.sigma > 0.0),
        left_out=tuple(left_out),
        datum=_words(put, bool(measured)),
        length_known=bool(measured),
    )


def _measured(model: ProbingModel, null: NullSpace, put: Sequence[Place]) -> tuple[list[Prior], list[str]]:
    rows = np.array([null.weights(place.weights) for place in put]).reshape(-1, len(null.names))
    by_name = {table.name: table for table in model.tables}
    good, bad = [], []
    for name, entry in model.description.known.items():
        weights = known_weights(by_name[name], entry.position)
        # A length at which no touch was says nothing of the lengths between the touches.
        if weights and null.fixes(rows, null.weights(weights)):
            good.append(Prior(weights, entry.value, entry.standard_uncertainty))
        else:
            bad.append(f"{name}({entry.position:.6g})")
    return good, bad


def _no_length(description: Probing, unused: Sequence[str]) -> NotDetermined:
    if not description.known:
        why = say("undetermined.no_length")
    else:
        why = say("undetermined.length_untouched", names=together(unused, say("text.and")))
    return NotDetermined(LENGTH, why)


def _words(put: Sequence[Place], measured: bool) -> str:
    relative = [] if measured else [say("datum.no_length")]
    form = say("datum.form" if measured else "datum.form_no_length")
    return together((together((place.words for place in put), ", "), *relative, form, say("datum.ecc")), "; ")
