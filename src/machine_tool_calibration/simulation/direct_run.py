# SPDX-License-Identifier: Apache-2.0
"""A session of an instrument that reads deviations directly."""

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.session.record import Finite, Positive
from machine_tool_calibration.session.values import Instrument
from machine_tool_calibration.simulation.flaw import Disturbance, Sight
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.motions import rotate
from machine_tool_calibration.simulation.plan import Interval, Measurement, Pause, Plan, Vector3, spanned, true_errors
from machine_tool_calibration.simulation.scene import Scene, blocks, last_direction, ordered_times

Kind = Literal["iso230_2", "straightness", "grid_plate", "drilled_plate", "points"]
Datum = Literal["none", "offset", "rigid"]
_DATUM: dict[str, Datum] = {"iso230_2": "none", "points": "none"}  # rigid of all others
_INSTRUMENT: dict[str, Instrument] = {
    "iso230_2": "laser_interferometer",
    "straightness": "straightedge",
    "grid_plate": "grid_encoder",
    "drilled_plate": "cmm",
}


class DirectPlan(Plan):
    """Deviations of the functional point along stated directions."""

    method: Literal["direct"] = "direct"
    # `iso230_2`: an axis in both directions, `repeats` runs (ISO 230-2); `straightness`: a straightedge along an axis;
    # `grid_plate`: a two-dimensional grid encoder, two readings a point; `drilled_plate`: a part drilled once and
    # measured on a coordinate measuring machine, two readings a hole; `points`: `points` and `directions` as given
    kind: Kind = "iso230_2"
    axis: Literal["x", "y", "z"] = "x"  # the axis that moves (iso230_2, straightness)
    sense: Literal["x", "y", "z"] = "y"  # the direction that is read (straightness)
    # ends of the measured line, or of both sides of the plate, m
    start: Finite = 0.0
    end: Finite = 0.4
    count: Annotated[int, Field(ge=2, le=1000)] = 11  # positions on the line, or along each side of the plate
    points: Annotated[tuple[Vector3, ...], Field(min_length=1)] | None = None  # functional points, m
    # the direction in which each is read (unit vectors)
    directions: Annotated[tuple[Vector3, ...], Field(min_length=1)] | None = None
    instrument: Instrument | None = None  # what reads; the kind's usual one if absent, none is named for `points`
    datum: Datum | None = None  # what the instrument leaves open; the kind's usual one if absent
    # standard deviation of the part's or instrument's position, m; its orientation is off by twice that per 0.1 m
    misplacement: Annotated[float, Field(ge=0)] = 2e-5
    terms: tuple[str, ...] | None = None  # machine errors that the session asks for; the kind's usual ones if absent
    both_ways: bool = False  # every run goes back (always so for iso230_2)
    # how often part or instrument is set up; each is a setup with its own misplacement
    mountings: Annotated[int, Field(ge=1, le=1000)] = 1
    interval: Interval = 5.0
    pause: Pause = 0.0
    noise: Positive = 2e-7

    @model_validator(mode="after")
    def _check(self) -> Self:
        points, directions = (len(own) if own else 1 for own in (self.points, self.directions))
        if points != directions and 1 not in (points, directions):
            raise ValueError(f"{points} points and {directions} directions: as many of both, or one of either")
        if any(not any(direction) for direction in self.directions or ()):
            raise ValueError("a direction must not be zero")
        return self

    def travel(self) -> dict[str, tuple[float, float]]:
        """Ends of the axes that hold all points and zero, m."""
        return spanned(self.run()[0])

    def run(self) -> tuple[Array, Array]:
        """(m, 3) points of one run, m, and (m, 3) unit directions in which they are read."""
        line = np.linspace(self.start, self.end, self.count)
        if self.kind == "points":
            points = np.asarray(self.points if self.points else [(0.0, 0.0, 0.0)], float)
            sense = np.asarray(self.directions if self.directions else [(1.0, 0.0, 0.0)], float)
            points, sense = np.broadcast_arrays(points, sense)
            return points, sense / np.linalg.norm(sense, axis=1, keepdims=True)
        if self.kind in ("iso230_2", "straightness"):
            letter = self.axis if self.kind == "iso230_2" else self.sense
            points = line[:, None] * np.eye(3)["xyz".index(self.axis)]
            return points, np.tile(np.eye(3)["xyz".index(letter)], (len(line), 1))
        y, x = (side.ravel() for side in np.meshgrid(line, line, indexing="ij"))
        points = np.column_stack([x, y, np.zeros(len(x))])
        return np.repeat(points, 2, axis=0), np.tile(np.eye(3)[:2], (len(points), 1))

    def asked(self) -> tuple[str, ...]:
        """Machine errors that the session asks for."""
        if self.terms is not None:
            return self.terms
        axis, sense = self.axis.upper(), self.sense.upper()
        usual: dict[str, tuple[str, ...]] = {
            "iso230_2": (f"E{axis}{axis}",),
            "straightness": (f"E{sense}{axis}",),
            "grid_plate": ("EXX", "EYX", "EXY", "EYY", "ECY", "C0Y"),
        }
        return usual.get(self.kind, ())

    def measured(self, rng: np.random.Generator) -> Measurement:
        """The measurement of a plan: one setup, run after run."""
        points, senses = self.run()
        forth = np.arange(len(points))
        one = np.concatenate([forth, forth[::-1]]) if self.both_ways or self.kind == "iso230_2" else forth
        index = np.tile(one, self.repeats * self.mountings)
        repeat = np.tile(np.repeat(np.arange(self.repeats), len(one)), self.mountings)
        setup = np.repeat(np.arange(self.mountings), self.repeats * len(one))
        position, sense = points[index], senses[index]
        time = ordered_times(setup, self.interval, self.pause)
        if self.kind not in ("iso230_2", "straightness"):  # readings at the same point are taken together
            visit = blocks(setup, repeat, *np.round(position.T * 1e9).astype(np.int64))
            time = visit * self.interval + setup * self.pause
        direction = {axis: last_direction(position[:, i]) for i, axis in enumerate("XYZ")}
        if self.kind == "iso230_2":  # each run overruns its ends: every position is approached in the run's direction
            sign = 1.0 if self.end > self.start else -1.0
            ahead = np.repeat([sign, -sign], len(forth))
            direction[self.axis.upper()] = np.tile(ahead, self.repeats * self.mountings)
        scene = Scene(time, setup, repeat, position, np.zeros(len(time)), direction, ends=self.travel())
        datum = self.datum or _DATUM.get(self.kind, "rigid")
        place, turned = rng.normal(size=(2, self.mountings, 3))
        place = self.misplacement * place * (datum != "none")
        turned = self.misplacement * 20.0 * turned * (datum == "rigid")

        def read(machine: VirtualMachine, disturbance: Disturbance) -> Array:
            # made or compared while the part is warm: at 20 degrees Celsius the distances are smaller
            actual = disturbance.functional_point(machine, position) / np.reshape(1.0 + disturbance.growth, (-1, 1))
            seen = rotate(actual, turned[setup]) + place[setup]
            deviation: Array = np.einsum("ni,ni->n", sense, seen - position)
            path = np.einsum("ni,ni->n", sense, position)
            sight = Sight(path, sense, azimuth=np.arctan2(sense[:, 1], sense[:, 0]), change=path)
            return deviation + disturbance.added(sight)

        def judged(machine: VirtualMachine) -> dict[str, Any]:
            out = true_errors(machine, np.unique(points, axis=0))
            if datum != "none":
                out["misplacement"] = {"translation": place.tolist(), "rotation": turned.tolist()}
            return out

        columns = {f"g{axis}": sense[:, i] for i, axis in enumerate("xyz")}
        return Measurement(self._described(datum), scene, read, None, columns, truth=judged)

    def _described(self, datum: str) -> dict[str, Any]:
        name = self.axis.upper() if self.kind in ("iso230_2", "straightness") else self.kind
        instrument = self.instrument or _INSTRUMENT.get(self.kind)
        return {
            **({"instrument": instrument} if instrument else {}),
            "datum": datum,
            "terms": list(self.asked()),
            "setups": [{"id": name if self.mountings == 1 else f"{name}{i + 1}"} for i in range(self.mountings)],
        }
