# SPDX-License-Identifier: Apache-2.0
"""A session with a double ball bar: circles in planes of two axes, both ways round (ISO 230-4)."""

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.session.record import NotNegative, Positive
from machine_tool_calibration.simulation.flaw import Disturbance, Sight
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.machine_file import Amplitudes
from machine_tool_calibration.simulation.plan import Measurement, Plan, Vector3, spanned, true_errors
from machine_tool_calibration.simulation.scene import Scene
from machine_tool_calibration.simulation.sensors import distance

_HALF_ARC = np.radians(110.0)  # circles of less than a whole turn are arcs of so much to both sides, rad


class CirclePlan(Plan):
    """Circles in one or more planes, at one or more feeds, counter-clockwise and clockwise in every repeat."""

    method: Literal["ball_bar"] = "ball_bar"
    planes: Annotated[tuple[Literal["XY", "YZ", "ZX"], ...], Field(min_length=1)] = ("XY",)
    centre: Vector3 = (0.25, 0.2, 0.15)  # where all circles have their centre, m
    radius: Positive = 0.15  # nominal length of the bar, m
    count: Annotated[int, Field(ge=8, le=100_000)] = 180  # readings of a circle
    # path speeds, m/s: as in production, and slow, where a servo hardly lags; each is a setup in every plane
    feeds: Annotated[tuple[Positive, ...], Field(min_length=1)] = (1.0 / 60.0, 0.3 / 60.0)
    # in planes with Z the bar clears the table over 220 degrees only (`upper`), or all round (`whole`)
    arc: Literal["upper", "whole"] = "upper"
    centring: NotNegative = 2e-5  # the centre is off by this (standard deviation per coordinate), m
    length_error: NotNegative = 5e-6  # the bar's length is off by this (standard deviation), m
    chain: str = "w-Y-X-b-Z-t"
    noise: Positive = 2e-7

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name, own in (("planes", self.planes), ("feeds", self.feeds)):
            if len(set(own)) < len(own):
                raise ValueError(f"{name} names one twice")
        return self

    def travel(self) -> dict[str, tuple[float, float]]:
        """Ends of the axes that hold all circles and zero, m."""
        centre = np.asarray(self.centre)
        reach = np.array([self.radius * any(axis in plane for plane in self.planes) for axis in "XYZ"])
        return spanned(np.stack([centre - reach, centre + reach]))

    def errors(self) -> Amplitudes:
        """Squareness, which circles show at once; what else is wrong is an effect, or in the machine's file."""
        return Amplitudes(positioning=0.0, straightness=0.0, angular=0.0, squareness=2e-5)

    def angles(self, plane: str) -> Array:
        """(k,) of a circle, counter-clockwise, rad: half a step off the axes, where they stand."""
        if "Z" not in plane or self.arc == "whole":
            return np.asarray((np.arange(self.count) + 0.5) * 2.0 * np.pi / self.count)
        upwards = 0.5 * np.pi if plane.endswith("Z") else 0.0
        return np.asarray(upwards + np.linspace(-_HALF_ARC, _HALF_ARC, self.count))

    def measured(self, rng: np.random.Generator) -> Measurement:
        """The measurement of a plan: plane by plane and feed by feed, in every repeat once each way round."""
        setups = [(plane, feed) for plane in self.planes for feed in self.feeds]
        circles = [
            (s, repeat, sense, self.angles(plane)[:: int(sense)])
            for s, (plane, _) in enumerate(setups)
            for repeat in range(self.repeats)
            for sense in (1.0, -1.0)
        ]
        size = [len(angle) for *_, angle in circles]
        setup, repeat = (np.repeat([c[k] for c in circles], size) for k in (0, 1))
        sense, angle = np.repeat([c[2] for c in circles], size), np.concatenate([c[3] for c in circles])
        # The bar stays where it is from feed to feed of one plane.
        mounting, feed = setup // len(self.feeds), np.array([feed for _, feed in setups])[setup]
        axes = np.array([["XYZ".index(a) for a in plane] for plane in self.planes])[mounting]
        arm, way = np.zeros((2, len(setup), 3))
        np.put_along_axis(arm, axes, self.radius * np.column_stack([np.cos(angle), np.sin(angle)]), axis=1)
        np.put_along_axis(way, axes, np.column_stack([-np.sin(angle), np.cos(angle)]) * sense[:, None], axis=1)
        centre = np.asarray(self.centre)
        position = centre + arm
        # Every circle is begun while the bar moves already, and the other way round follows after an interval.
        interval = [self.radius * abs(a[1] - a[0]) / setups[s][1] for s, *_, a in circles]
        begun = np.cumsum([0.0, *(k * step + self.interval for k, step in zip(size, interval, strict=True))])
        number = np.concatenate([np.arange(k) for k in size])
        time = np.repeat(begun[:-1], size) + number * np.repeat(interval, size) + mounting * self.pause
        direction = {letter: np.where(way[:, j] < 0.0, -1.0, 1.0) for j, letter in enumerate("XYZ")}
        unit = arm / self.radius
        scene = Scene(
            time, setup, repeat, position, np.zeros(len(time)), direction, ends=self.travel(),
            velocity={letter: feed * way[:, j] for j, letter in enumerate("XYZ")},
            since_reversal={
                letter: self.radius * np.arccos(np.clip(-unit[:, j] * direction[letter], -1.0, 1.0))
                for j, letter in enumerate("XYZ")
            },
        )  # fmt: skip
        off = self.centring * rng.normal(size=(len(self.planes), 3))
        length = self.radius + self.length_error * rng.normal(size=len(self.planes))

        def read(machine: VirtualMachine, disturbance: Disturbance) -> Array:
            actual, stand = disturbance.functional_point(machine, position), centre + off[mounting]
            path = distance(actual, stand)
            sight = Sight(path, (actual - stand) / path[:, None], azimuth=angle, change=path - self.radius)
            return np.asarray(path - length[mounting] + disturbance.added(sight))

        def judged(machine: VirtualMachine) -> dict[str, Any]:
            found = true_errors(machine, np.unique(position, axis=0))
            return found | {"centres": (centre + off).tolist(), "lengths": length.tolist()}

        description = {
            "setups": [
                {"id": plane if feed == self.feeds[0] else f"{plane}_{6e4 * feed:.0f}mm_per_min", "plane": plane}
                | {"centre": list(self.centre), "radius": self.radius, "feed": feed}
                for plane, feed in setups
            ]
        }
        return Measurement(description, scene, read, None, truth=judged)
