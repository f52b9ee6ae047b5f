# SPDX-License-Identifier: Apache-2.0
"""What a ball bar should read: radius deviation against the machine's errors in the plane.

With u the unit vector from the centre to the tool, a displacement e of the tool changes the reading by u.e, an offset c
of the centre by -u.c, and a bar that is longer than stated by -1. The mean scale of X and Y cannot be distinguished
from the bar's length; the difference of the two can.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from circle_gauge.spec import CircleGauge
from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.estimation.problem import LinearPart, Part, group_rows
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import MethodModel, NotDetermined, Parameter, Term
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.model.rigid_body import MachineTable, map_field
from machine_tool_calibration.session.session import Session, distinct_places


@dataclass(frozen=True)
class CircleModel(MethodModel):
    """Centre and length of the bar for each circle; squareness and scale mismatch of the machine."""

    tables: tuple[MachineTable, ...]

    @property
    def own(self) -> tuple[Parameter, ...]:
        """Offset of the centre and excess length of the bar."""
        ids = self.observations.session.setup_ids
        return tuple(Parameter(f"{name}.{what}", "m") for name in ids for what in ("centre_x", "centre_y", "length"))

    def part(self, own_index: IntArray, dense_index: IntArray) -> Part:
        """Every circle is a block."""
        readings, direction = self.observations.readings, self.observations.direction
        return LinearPart(
            groups=group_rows(readings.setup),
            reading=readings.displacement,
            sigma=self.sigma,
            local=np.zeros((0, len(readings))),
            block=-np.stack([direction[:, 0], direction[:, 1], np.ones(len(readings))]),
            dense=self.dense(),
            block_index=own_index.reshape(-1, 3),
            dense_index=dense_index,
        )


def error_map(model: CircleModel, fit: Fit) -> ErrorMap:
    """Position errors by squareness and scale mismatch; nothing is read along Z."""
    points = model.observations.position[distinct_places(model.observations.position)[0]]
    field = np.concatenate([map_field(model.tables, points), mismatch(points)])
    own = len(model.own)
    mine = slice(own, own + len(field))
    covariance = np.einsum("knd,kl,lne->nde", field, fit.covariance[mine, mine], field)
    error = np.einsum("k,knd->nd", fit.theta[mine], field)
    uncertainty = np.sqrt(np.einsum("nii->ni", covariance))
    error[:, 2], uncertainty[:, 2] = np.nan, np.nan
    value, u = fit.theta[own], np.sqrt(fit.covariance[own, own])
    content: dict[str, Any] = {
        "points": points,
        "position_error": error,
        "position_error_u": uncertainty,
        "tables": {"C0Y": {"value": value, "value_u": u}},
    }
    return ErrorMap(content, points, error, uncertainty)


def mismatch(position: Array) -> Array:
    """(1, n, 3) displacement per unit by which the scale of Y is larger than that of X."""
    return np.asarray((position * (-0.5, 0.5, 0.0))[None])


def build(session: Session, model: str) -> CircleModel:
    """The model of a session of circles.

    Raises:
        ModelError: no reading.
    """
    description = session.description.as_a(CircleGauge)
    readings = session.readings.select(np.isfinite(session.readings.displacement))
    if not len(readings):
        raise ModelError("no reading: every displacement is missing")
    position = readings.position()
    arm = (position - np.array([setup.centre for setup in description.setups])[readings.setup]) * (1.0, 1.0, 0.0)
    direction = arm / np.linalg.norm(arm, axis=1)[:, None]
    zero = np.zeros_like(direction)
    observations = Observations(session, readings, position, direction, zero, np.zeros(len(readings)), readings.setup)
    squareness = MachineTable(description.machine.kinematics, "C0Y", np.empty(0))
    scale = observations.sense(mismatch(position))
    return CircleModel(
        observations=observations,
        terms=(
            Term("C0Y", squareness.parameters, squareness.weights(position) * squareness.scalar(position, direction)),
            Term("scale_mismatch", (Parameter("scale_mismatch", "1"),), scale),
        ),
        constraints=(),
        priors=(),
        left_out=(NotDetermined("mean_scale", "the length of the bar changes every reading as the mean scale does"),),
        datum="centre and length of the bar are free in every circle; C0Y is that of Y against X",
        tables=(squareness,),
    )
