# SPDX-License-Identifier: Apache-2.0
"""A session on a rotary axis: stations that look at targets on the table (sequential multilateration)."""

from dataclasses import replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from machine_tool_calibration.arrays import Array, groups
from machine_tool_calibration.session.record import Finite, Positive
from machine_tool_calibration.simulation import plan
from machine_tool_calibration.simulation.flaw import Disturbance, Sight
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.motions import motion_names
from machine_tool_calibration.simulation.scene import Scene, last_direction, ordered_times
from machine_tool_calibration.simulation.sensors import distance

# The targets of Zhang et al. 2015, Section 4.2; the stations are chosen around them.
_TARGETS = {
    "P": (-0.1058046, 0.1353414, 0.0),
    "Q": (0.1288513, 0.0878158, 0.0399797),
    "K": (0.0249026, -0.1108575, 0.0152662),
}
_STATIONS = ((-0.7, -0.5, 0.2), (0.8, -0.6, 0.35), (0.65, 0.75, 0.15), (-0.3, 0.35, 1.1))


def sighted(actual: Array, source: Array, axis: str, turned: Array) -> Sight:
    """What a tracker at (n, 3) reads of targets at (n, 3), m, on a table `turned` (n,) counter-clockwise, rad."""
    line, path = actual - source, distance(actual, source)
    first, second = (("ABC".index(axis) + k) % 3 for k in (1, 2))
    incidence = np.arctan2(line[:, second], line[:, first]) - turned
    return Sight(path, line / path[:, None], np.arctan2(line[:, 1], line[:, 0]), incidence)


class RotaryPlan(plan.Plan):
    """Stations, targets and angles; without arguments the three targets and 20 degree steps of the paper.

    For an axis A or B the default targets and stations are those for C with the coordinates turned round, so
    that they lie about that axis in the same way.
    """

    method: Literal["rotary_axis"] = "rotary_axis"
    axis: Literal["A", "B", "C"] = "C"  # the rotary axis
    targets: dict[str, plan.Vector3] | None = None  # by id, in the table frame at zero, nominal, m
    stations: Annotated[tuple[plan.Vector3, ...], Field(min_length=1)] | None = None  # nominal positions, m
    # commanded angles, rad; 18 steps of 20 degrees if absent
    angles: Annotated[tuple[Finite, ...], Field(min_length=1, max_length=100_000)] | None = None
    # each run goes back through the same angles, so that drift is distinguished from the angle, and backlash shows
    both_ways: bool = True
    at_every_angle: bool = False  # every target is read at each angle, as in the paper; or the axis turns for each
    # standard deviation of the stated stations per coordinate, m
    station_uncertainty: Annotated[float, Field(ge=0)] = 2e-4
    target_uncertainty: Annotated[float, Field(ge=0)] = 5e-5  # likewise of the stated targets
    # target id -> (from, to): angles at which it cannot be seen, rad
    hidden: dict[str, tuple[Finite, Finite]] = Field(default_factory=dict)
    interval: plan.Interval = 3.0
    pause: plan.Pause = 900.0
    noise: Positive = 2.7e-7
    chain: str = ""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if unknown := [name for name in self.hidden if name not in self.marks()]:
            raise ValueError(f"hidden names target {unknown[0]!r}, which is none of {', '.join(self.marks())}")
        if not self.chain:
            object.__setattr__(self, "chain", f"w-{self.axis}-b-t")
        return self

    def machine(self) -> dict[str, Any]:
        """The chain, and which of its axes is measured."""
        return {"chain": self.chain, "axis": self.axis}

    def marks(self) -> dict[str, plan.Vector3]:
        """Nominal targets by id."""
        return self.targets or {name: _about(p, self.axis) for name, p in _TARGETS.items()}

    def places(self) -> Array:
        """(k, 3) nominal stations, m."""
        return np.array(self.stations or [_about(p, self.axis) for p in _STATIONS], float)

    def turns(self) -> Array:
        """Commanded angles of one run, rad."""
        once = np.array(self.angles or [k * 2.0 * np.pi / 18.0 for k in range(18)])
        return np.concatenate([once, once[::-1]]) if self.both_ways else once

    def senses(self) -> Array:
        """Sign of the last move before each reading; the axis overruns the last angle, to approach it both ways."""
        turns = self.turns()
        if not self.both_ways:
            return last_direction(turns)
        forth, back = np.split(turns, 2)
        there = last_direction(forth)
        return np.concatenate([there, last_direction(back, -there[-1])])

    def measured(self, rng: np.random.Generator) -> plan.Measurement:
        """The measurement: station by station, repeat by repeat; all angles for each target, or the reverse."""
        names = list(self.marks())
        nominal = np.array([self.marks()[name] for name in names], float)
        station = self.places()
        estimate = station + self.station_uncertainty * rng.normal(size=station.shape)
        target = nominal + self.target_uncertainty * rng.normal(size=nominal.shape)
        turns = self.turns()
        inner = (len(turns), len(names)) if self.at_every_angle else (len(names), len(turns))
        setup, repeat, *within = (index.ravel() for index in np.indices((len(station), self.repeats, *inner)))
        label, step = reversed(within) if self.at_every_angle else within
        keep = np.ones(len(setup), bool)
        for name, (low, high) in self.hidden.items():
            keep &= ~((label == names.index(name)) & (turns[step] >= low) & (turns[step] <= high))
        time = ordered_times(setup, self.interval, self.pause)[keep]
        setup, repeat, label, step = setup[keep], repeat[keep], label[keep], step[keep]
        angle = turns[step]
        run = groups(setup, repeat, label)
        direction = self.senses()[step]
        scene = Scene(time, setup, repeat, np.zeros((len(time), 3)), angle, {self.axis: direction}, axis=self.axis)

        def read(machine: VirtualMachine, disturbance: Disturbance) -> Array:
            actual = disturbance.on_table(machine, target[label], angle, self.axis) + disturbance.point
            source = station[setup] + disturbance.station
            sight = sighted(actual, source, self.axis, machine.rotation_sign * angle)
            return sight.path + disturbance.added(replace(sight, change=plan.since_first(sight.path, run)))

        def judged(machine: VirtualMachine) -> dict[str, Any]:
            at = np.unique(turns)
            return {
                "angles": at.tolist(),
                "errors": {name: machine.motion(name, at).tolist() for name in motion_names(self.axis)},
                "average_line": dict(machine.average_line),
                "stations": station.tolist(),
                "targets": dict(zip(names, target.tolist(), strict=True)),
            }

        description = {
            "rotation_sign": self.sign,
            "targets": plan.declared_places(nominal, self.target_uncertainty, names),
            "setups": plan.declared_places(estimate, self.station_uncertainty),
        }
        labels = {"target": np.array(names, dtype=object)[label]}
        return plan.Measurement(description, scene, read, run, labels=labels, truth=judged)


def _about(p: tuple[float, float, float], axis: str) -> plan.Vector3:
    """A point given for C, turned round so that it lies about another axis."""
    shift = {"C": 0, "A": 1, "B": 2}[axis]
    return (p[-shift], p[1 - shift], p[2 - shift])
