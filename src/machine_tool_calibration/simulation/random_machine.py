# SPDX-License-Identifier: Apache-2.0
"""Random machines: smooth errors of stated size from a seed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

import numpy as np
from pydantic import Field

from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.session.record import NotNegative, Record
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.motions import AxisMotion, Table, motion_names, random_periodic, random_smooth

__all__ = ["Amplitudes", "random_machine"]


class Amplitudes(Record):
    """Largest absolute value of each kind of error; the sizes of a good machining centre by default.

    Attributes:
        positioning: EXX, EYY, EZZ, m.
        straightness: EYX, EZX and so on, m.
        angular: EAX … ECZ, rad.
        squareness: A0Z, B0Z, C0Y, rad (uniform between plus and minus this).
        rotary_translation: EXC, EYC, EZC, m.
        rotary_tilt: EAC, EBC, rad.
        rotary_angle: ECC, rad.
        line_position: X0C, Y0C, m (uniform).
        line_orientation: A0C, B0C, rad (uniform).
        knots: nodes of a linear axis's splines; more give shorter waves.
    """

    positioning: NotNegative = 5e-6
    straightness: NotNegative = 3e-6
    angular: NotNegative = 1e-5
    squareness: NotNegative = 1e-5
    rotary_translation: NotNegative = 4e-6
    rotary_tilt: NotNegative = 1e-5
    rotary_angle: NotNegative = 1.5e-5
    line_position: NotNegative = 0.0
    line_orientation: NotNegative = 0.0
    knots: Annotated[int, Field(ge=2, le=200)] = 7


def random_machine(
    chain: Chain | str,
    travel: Mapping[str, tuple[float, float]],
    seed: int | np.random.Generator = 0,
    amplitudes: Amplitudes | None = None,
    *,
    rotation_sign: int = 1,
) -> VirtualMachine:
    """A machine with smooth random error motions, the same for the same seed.

    Args:
        chain: chain of axes.
        travel: lower and upper end of each linear axis by letter (either case), m.
        seed: seed, or a source of chance.
        amplitudes: sizes of the errors.
        rotation_sign: sense of the rotary axes.

    Raises:
        ModelError: a linear axis of the chain has no travel.
    """
    chain = Chain.parse(chain) if isinstance(chain, str) else chain
    rng = np.random.default_rng(seed)
    size = amplitudes or Amplitudes()
    ends = {name.upper(): (float(low), float(high)) for name, (low, high) in travel.items()}
    motions = {}
    for axis in "XYZABC":  # always in this order, so that the errors do not depend on the chain's
        if axis not in chain.axes:
            continue
        if axis in "XYZ":
            if axis not in ends:
                raise ModelError(f"the travel of {axis} is needed for its error motions")
            tables = _linear(rng, axis, ends[axis], size)
        else:
            tables = _rotary(rng, axis, size)
        motions[axis] = AxisMotion(axis, tables)
    squareness = {
        name: float(rng.uniform(-size.squareness, size.squareness))
        for name in ("C0Y", "B0Z", "A0Z")
        if name[2] in chain.axes
    }
    line: dict[str, float] = {}
    for axis in chain.rotary:
        across = [i for i in range(3) if "ABC"[i] != axis]
        line |= {f"{'XYZ'[i]}0{axis}": float(rng.uniform(-1, 1) * size.line_position) for i in across}
        line |= {f"{'ABC'[i]}0{axis}": float(rng.uniform(-1, 1) * size.line_orientation) for i in across}
    return VirtualMachine(chain, motions, squareness, line, ends, rotation_sign)


def _linear(
    rng: np.random.Generator, axis: str, ends: tuple[float, float], size: Amplitudes
) -> tuple[tuple[str, Table], ...]:
    names = motion_names(axis)
    along = {name: size.positioning if name[1] == axis else size.straightness for name in names}
    amplitudes = [size.angular if name[1] in "ABC" else along[name] for name in names]
    return tuple(zip(names, random_smooth(rng, *ends, amplitudes, knots=size.knots), strict=True))


def _rotary(rng: np.random.Generator, axis: str, size: Amplitudes) -> tuple[tuple[str, Table], ...]:
    names = motion_names(axis)
    about = {name: size.rotary_angle if name[1] == axis else size.rotary_tilt for name in names}
    amplitudes = [size.rotary_translation if name[1] in "XYZ" else about[name] for name in names]
    return tuple(zip(names, random_periodic(rng, amplitudes), strict=True))
