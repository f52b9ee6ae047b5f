# SPDX-License-Identifier: Apache-2.0
"""A session of laser step diagonals and linear runs with a flat mirror on the spindle."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.session.description import DiagonalSetup
from machine_tool_calibration.session.record import Positive
from machine_tool_calibration.simulation import plan
from machine_tool_calibration.simulation.flaw import Disturbance, Sight
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.machine_file import Amplitudes
from machine_tool_calibration.simulation.scene import Scene, blocks, last_direction, ordered_times
from machine_tool_calibration.simulation.sensors import mirror_path, tilted

Order = Literal["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"]
Signs = Annotated[str, Field(pattern=r"^([pn]{3}|0[pn]{2}|[pn]0[pn]|[pn]{2}0)$")]
Letter = Literal["x", "y", "z"]
Offset = Annotated[str, Field(pattern=r"^(x(y|z|yz)|y(x|z|xz)|z(x|y|xy))$")]


class DiagonalPlan(plan.Plan):
    """Step diagonals of single-axis moves; without arguments the four space diagonals of a cube of 120 mm.

    The paper runs three (ppp, npp, pnp), in 12 blocks of 10 mm. Three leave angular errors to be taken for straightness
    where the fourth distinguishes them; 10 blocks of 12 mm make up for its readings.
    """

    method: Literal["step_diagonal"] = "step_diagonal"
    step: tuple[Positive, Positive, Positive] = (0.012, 0.012, 0.012)  # length of a move along x, y, z, m
    blocks: Annotated[int, Field(ge=1, le=100_000)] = 10  # number of blocks
    corner: plan.Vector3 = (0.0, 0.0, 0.0)  # lowest corner of the measured volume, m
    # signs of the motion along x, y, z (p or n); 0 for an axis that stands still, as in `pp0` in the XY plane
    diagonals: tuple[Signs, ...] = ("ppp", "npp", "pnp", "nnp")
    # orders of the single-axis moves; each diagonal is run in each of them
    orders: Annotated[tuple[Order, ...], Field(min_length=1)] = ("xyz",)
    linear: tuple[Letter, ...] = ("x", "y", "z")  # axes also measured one by one, along the edges from the corner
    # further linear runs, where other axes stand at the far end: `xy` is a run along x at the end of y, `xyz` one at
    # the ends of y and z. There the angular errors show through lever arms
    offset_linear: tuple[Offset, ...] = ()
    # angle between each setup's mirror normal and its beam, in a random direction, rad
    mirror_tilt: Annotated[float, Field(ge=0, lt=1)] = 1e-3
    # standard deviation of the beam's direction off the actual diagonal, rad
    beam_error: Annotated[float, Field(ge=0, lt=1)] = 0.0
    distance: Positive = 0.3  # from the laser to the mirror at the start of a run, m
    repeats: Annotated[int, Field(ge=1, le=10000)] = 2
    interval: plan.Interval = 12.0
    pause: plan.Pause = 108.0
    noise: Positive = 1e-7
    chain: str = "w-Y-X-b-Z-t"

    def travel(self) -> dict[str, tuple[float, float]]:
        """Ends of the measured volume, m."""
        return {a: (c, c + s * self.blocks) for a, c, s in zip("XYZ", self.corner, self.step, strict=True)}

    def errors(self) -> Amplitudes:
        """Errors of a high-precision machining centre, with small angular ones."""
        return Amplitudes(positioning=1.5e-6, straightness=1.5e-6, angular=2e-6, squareness=3e-5)

    def runs(self) -> list[DiagonalSetup]:
        """The setups in the order in which they are measured."""
        corner, step = np.asarray(self.corner), np.asarray(self.step)
        out = []
        for signs in self.diagonals:
            sign = np.array([{"p": 1.0, "n": -1.0, "0": 0.0}[letter] for letter in signs])
            start = np.where(sign < 0, corner + self.blocks * step, corner)
            names = [signs] if self.orders == ("xyz",) else [f"{signs}_{order}" for order in self.orders]
            out += [_setup(name, "diagonal", sign, start) for name in names]
        for letters in (*self.linear, *self.offset_linear):
            sign, far = (np.array([float(other in own) for other in "xyz"]) for own in (letters[0], letters[1:]))
            name = letters[0].upper() + (f"_at_{letters[1:]}" if letters[1:] else "")
            out.append(_setup(name, "linear", sign, corner + far * self.blocks * step))
        return out

    def measured(self, rng: np.random.Generator) -> plan.Measurement:
        """The measurement of a plan: every setup once, then all again for the next repeat."""
        runs = self.runs()
        paths = [np.array(run.path(self.step, self.blocks)) for run in runs]
        angle = rng.uniform(0.0, 2.0 * np.pi, len(runs))
        tilt = self.mirror_tilt * np.column_stack([np.cos(angle), np.sin(angle)])
        aside = self.beam_error * rng.normal(size=(len(runs), 2))
        setup = np.tile(np.concatenate([np.full(len(path), i) for i, path in enumerate(paths)]), self.repeats)
        repeat = np.repeat(np.arange(self.repeats), sum(map(len, paths)))
        position = np.tile(np.concatenate(paths), (self.repeats, 1))
        block = blocks(setup, repeat)
        time = ordered_times(block, self.interval, self.pause)
        direction = {
            axis: np.concatenate([last_direction(position[block == b, i]) for b in range(block[-1] + 1)])
            for i, axis in enumerate("XYZ")
        }
        scene = Scene(time, setup, repeat, position, np.zeros(len(time)), direction, ends=self.travel())
        start, end = (np.array([path[k] for path in paths]) for k in (0, -1))

        def read(machine: VirtualMachine, disturbance: Disturbance) -> Array:
            first, last = machine.functional_point(start), machine.functional_point(end)
            beam = tilted((last - first) / np.linalg.norm(last - first, axis=1, keepdims=True), aside)
            source = first - self.distance * beam
            actual = disturbance.functional_point(machine, position)
            normal = tilted(beam[setup], tilt[setup] + disturbance.mirror)
            fixed = np.einsum("nji,nj->ni", machine.tool_rotation(start)[setup], normal)  # in the spindle's frame
            path = mirror_path(source[setup], beam[setup], actual, machine.carried(position, fixed, disturbance.errors))
            moved = path - self.distance
            sight = Sight(moved, beam[setup], change=plan.since_first(moved, block))
            return path + disturbance.added(sight)

        def judged(machine: VirtualMachine) -> dict[str, Any]:
            errors = {letter: self._axis_error(machine, axis).tolist() for axis, letter in enumerate("xyz")}
            return {"axis_errors": errors, "squareness": dict(machine.squareness), "mirror_tilt": tilt.tolist()}

        description = {"step": list(self.step), "blocks": self.blocks, "setups": [run.model_dump() for run in runs]}
        return plan.Measurement(description, scene, read, block, truth=judged)

    def _axis_error(self, machine: VirtualMachine, axis: int) -> Array:
        """(blocks + 1, 3) position errors along an axis from the corner, less those of the corner, m."""
        steps = np.arange(self.blocks + 1)[:, None] * self.step[axis] * np.eye(3)[axis]
        error = machine.position_error(np.asarray(self.corner) + steps)
        return np.asarray(error - error[0])


def _setup(name: str, kind: str, sign: Array, start: Array) -> DiagonalSetup:
    return DiagonalSetup.model_validate({"id": name, "kind": kind, "direction": sign.tolist(), "start": start.tolist()})
