# SPDX-License-Identifier: Apache-2.0
"""A session with a tracking interferometer at several stations."""

from dataclasses import replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.session.record import Finite, NotNegative
from machine_tool_calibration.simulation import plan
from machine_tool_calibration.simulation.flaw import Disturbance, Sight
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.scene import Scene, last_direction, ordered_times
from machine_tool_calibration.simulation.sensors import Pointer, aim, distance, sensed_path

_STATIONS: dict[int, tuple[tuple[float, float, float], ...]] = {
    2: ((-0.35, 0.05, 0.0), (0.15, -0.4, 0.0), (0.7, 0.3, 0.0), (0.1, 0.85, 0.0)),
    3: ((-0.4, -0.3, -0.1), (0.8, -0.2, 0.0), (0.1, 0.9, -0.1), (0.3, 0.2, 1.1)),
}
_SIXTH = tuple(float(v) for v in np.linspace(0.0, 0.4, 6))
_FIFTH = tuple(float(v) for v in np.linspace(0.0, 0.4, 5))
Line = Annotated[tuple[Finite, ...], Field(min_length=1, max_length=100_000)]


def sighted(actual: Array, origin: Array, azimuth: Array, dimension: int, held: Array | None = None) -> Sight:
    """What an interferometer reads of a retroreflector on the spindle, which really is at (n, 3), m.

    From the beam's origin (n, 3), m, and azimuth (n,) as commanded, rad, in so many dimensions; `held` (n, 3) is the
    direction of a beam that is held on it, None for one that follows the target.
    """
    path = distance(actual, origin) if held is None else sensed_path(actual, origin, held)
    direction = (actual - origin) / path[:, None] if held is None else held
    # the spindle does not turn: in the plane the beam's azimuth counts, in space its angle to the spindle
    incidence = azimuth if dimension == 2 else np.arccos(np.clip(direction[:, 2], -1.0, 1.0))
    return Sight(path, direction, azimuth, incidence)


class TrackingPlan(plan.Plan, Pointer):
    """Stations and targets; without them a square of 0.4 m (2-D) or a cube of 0.4 m (3-D) from four stations."""

    method: Literal["tracking_interferometer"] = "tracking_interferometer"
    dimension: Literal[2, 3] = 2
    pointing: Literal["open_loop", "tracking"] = "open_loop"
    stations: tuple[plan.Vector3, ...] | None = None  # nominal rotation centres, m
    # lines of a grid of targets, m; x runs fastest
    x: Line | None = None
    y: Line | None = None
    z: Line | None = None
    # targets one by one instead of a grid, m
    points: Annotated[tuple[plan.Vector3, ...], Field(min_length=1)] | None = None
    station_uncertainty: NotNegative = 1.2e-5  # standard deviation of the estimated stations per coordinate, m
    # every second repeat runs backwards (`alternate`), or all run alike (`same`)
    order: Literal["alternate", "same"] = "alternate"
    repeats: Annotated[int, Field(ge=1, le=10000)] = 2

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.points is not None and (self.x or self.y or self.z):
            raise ValueError("give either points or the grid x, y, z")
        if self.stations is not None and not self.stations:
            raise ValueError("stations must not be empty")
        return self

    def places(self) -> Array:
        """(k, 3) nominal stations, m."""
        return np.asarray(self.stations if self.stations is not None else _STATIONS[self.dimension], float)

    def targets(self) -> Array:
        """(m, 3) commanded targets in the order of the first run, m."""
        if self.points is not None:
            return np.asarray(self.points, float)
        default = _SIXTH if self.dimension == 2 else _FIFTH
        z, y, x = np.meshgrid(
            self.z or ((0.0,) if self.dimension == 2 else default), self.y or default, self.x or default, indexing="ij"
        )
        return np.column_stack([x.ravel(), y.ravel(), z.ravel()])

    def travel(self) -> dict[str, tuple[float, float]]:
        """Ends of the axes that hold all targets, with the zero, m."""
        return plan.spanned(self.targets())

    def measured(self, rng: np.random.Generator) -> plan.Measurement:
        """The measurement of a plan: true stations by chance around the estimates, one run per repeat and station."""
        truth = self.places()
        spread = rng.normal(size=truth.shape) * self.station_uncertainty
        if self.dimension == 2:
            spread[:, 2] = 0.0
        estimate = truth + spread
        targets, runs = self.targets(), self.repeats
        forward = np.arange(len(targets))
        one = [forward[::-1] if self.order == "alternate" and r % 2 else forward for r in range(runs)]
        index = np.tile(np.concatenate(one), len(truth))
        setup = np.repeat(np.arange(len(truth)), runs * len(targets))
        repeat = np.tile(np.repeat(np.arange(runs), len(targets)), len(truth))
        time = ordered_times(setup, self.interval, self.pause)
        position = targets[index]
        direction = {axis: last_direction(position[:, i]) for i, axis in enumerate("XYZ")}
        scene = Scene(time, setup, repeat, position, np.zeros(len(time)), direction, ends=self.travel())
        azimuth, elevation = aim(estimate[setup], position, self.dimension)

        def read(machine: VirtualMachine, disturbance: Disturbance) -> Array:
            actual = disturbance.functional_point(machine, position)
            station = truth[setup] + disturbance.station
            if self.pointing == "tracking":
                sight = sighted(actual, station, azimuth, self.dimension)
            else:
                origin, held = self.beam(azimuth, elevation, station, disturbance.turn)
                sight = sighted(actual, origin, azimuth, self.dimension, held)
            return sight.path + disturbance.added(replace(sight, change=plan.since_first(sight.path, setup)))

        def judged(machine: VirtualMachine) -> dict[str, Any]:
            return plan.true_errors(machine, targets) | {"stations": truth.tolist()}

        description = {
            "dimension": self.dimension,
            "pointing": self.pointing,
            "setups": plan.declared_places(estimate, self.station_uncertainty),
        }
        columns = {"azimuth": azimuth, "elevation": elevation}
        return plan.Measurement(description, scene, read, setup, columns, truth=judged)
