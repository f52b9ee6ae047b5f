# SPDX-License-Identifier: Apache-2.0
"""True errors of a machine as a YAML document: tables, squareness, axis average line, or random ones from a seed."""

from collections.abc import Container, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from machine_tool_calibration.errors import CalibrationError, ModelError
from machine_tool_calibration.machine.chain import Chain
from machine_tool_calibration.session.record import AnyRecord, NotNegative, Record, validated
from machine_tool_calibration.session.text import read_yaml
from machine_tool_calibration.session.values import Finite
from machine_tool_calibration.simulation import motions as error_motions
from machine_tool_calibration.simulation.machine import VirtualMachine


class Amplitudes(Record):
    """Largest absolute value of each kind of error; the sizes of a good machining centre by default."""

    positioning: NotNegative = 5e-6  # EXX, EYY, EZZ, m
    straightness: NotNegative = 3e-6  # EYX, EZX and so on, m
    angular: NotNegative = 1e-5  # EAX … ECZ, rad
    squareness: NotNegative = 1e-5  # A0Z, B0Z, C0Y, rad (uniform between plus and minus this)
    rotary_translation: NotNegative = 4e-6  # EXC, EYC, EZC, m
    rotary_tilt: NotNegative = 1e-5  # EAC, EBC, rad
    rotary_angle: NotNegative = 1.5e-5  # ECC, rad
    line_position: NotNegative = 0.0  # X0C, Y0C, m (uniform)
    line_orientation: NotNegative = 0.0  # A0C, B0C, rad (uniform)
    knots: Annotated[int, Field(ge=2, le=200)] = 7  # nodes of a linear axis's splines; more give shorter waves


def random_machine(
    chain: Chain, ends: Mapping[str, tuple[float, float]], seed: int | np.random.Generator, size: Amplitudes, sign: int
) -> VirtualMachine:
    """A machine with smooth random error motions of some sizes, the same for the same seed or source of chance.

    Each linear axis of the chain must have a travel, its lower and upper end by letter, m.
    """
    rng = np.random.default_rng(seed)
    motions = {}
    for axis in "XYZABC":  # always in this order, so that the errors do not depend on the chain's
        if axis in chain.linear and axis not in ends:
            raise ModelError(f"the travel of {axis} is needed for its error motions")
        if axis in chain.axes:
            motions[axis] = _motion(rng, axis, size, ends)
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
    return VirtualMachine(chain, motions, squareness, line, ends, sign)


def _motion(
    rng: np.random.Generator, axis: str, size: Amplitudes, ends: Mapping[str, tuple[float, float]]
) -> error_motions.AxisMotion:
    """Random error motions of an axis; of a linear one between its ends."""
    names, is_linear = error_motions.motion_names(axis), axis in "XYZ"
    if is_linear:
        own, shift, turn = size.positioning, size.straightness, size.angular
    else:
        own, shift, turn = size.rotary_angle, size.rotary_translation, size.rotary_tilt
    amplitudes = [own if name[1] == axis else turn if name[1] in "ABC" else shift for name in names]
    if is_linear:
        tables = error_motions.random_smooth(rng, *ends[axis], amplitudes, knots=size.knots)
    else:
        tables = error_motions.random_periodic(rng, amplitudes)
    return error_motions.AxisMotion(axis, tuple(zip(names, tables, strict=True)))


_SHORTEST_TRAVEL = 1e-6  # m or rad
# Nodes by which a sum of motions of different nodes is told: beside a spline of a tenth of the travel straight lines
# between them are off by a hundred-thousandth.
_FINE = 801


class TableSpec(Record):
    """One error motion: values at nodes of the axis, m or rad."""

    nodes: Annotated[tuple[Finite, ...], Field(min_length=2, max_length=100_000)]
    values: Annotated[tuple[Finite, ...], Field(min_length=2, max_length=100_000)]
    interpolation: Literal["cubic", "linear", "periodic"] = "cubic"

    @model_validator(mode="after")
    def _check(self) -> Self:
        self.table()
        return self

    def table(self) -> error_motions.Table:
        """The motion; a ModelError where its nodes and values are unfit."""
        return error_motions.Table(self.nodes, self.values, self.interpolation)


class MachineSpec(Record):
    """A machine's true errors."""

    chain: str | None = None  # chain of axes; the measurement's own if absent
    travel: dict[str, tuple[Finite, Finite]] = Field(default_factory=dict)  # the measurement's own ends, m, if absent
    rotation_sign: Literal[-1, 1] | None = None  # +1 counter-clockwise, -1 clockwise for a positive rotary command
    seed: Annotated[int, Field(ge=0)] | None = None  # of the random errors; the simulation's own if absent
    # sizes of random errors (an empty mapping: those of an ordinary machining centre); `null`: no random errors.
    # Without this key the errors are random, of sizes that suit the measurement
    random: Amplitudes | None = Amplitudes()
    motions: dict[str, TableSpec] = Field(default_factory=dict)  # error motions by name, added to the random ones
    squareness: dict[str, Finite] = Field(default_factory=dict)  # likewise, rad
    average_line: dict[str, Finite] = Field(default_factory=dict)  # X0C, Y0C, A0C, B0C, likewise, m and rad
    tool_offset: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)  # from the last carriage to the functional point, m


def build_machine(
    spec: MachineSpec,
    *,
    chain: str | None = None,
    travel: Mapping[str, tuple[float, float]] | None = None,
    rotation_sign: int = 1,
    seed: Any = 0,
    random: Amplitudes | None = None,
) -> VirtualMachine:
    """The machine of a spec, with arguments for what it lacks; a CalibrationError: no chain, or unfit tables."""
    if (text := spec.chain or chain) is None:
        raise ModelError("the machine needs a chain, such as w-C-b-Y-X-Z-t")
    try:
        parsed = Chain.parse(text)
    except ValueError as error:
        raise ModelError(str(error)) from None
    named = (*(travel or {}).items(), *spec.travel.items())
    ends = {axis.upper(): (float(low), float(high)) for axis, (low, high) in named}
    for axis, (low, high) in ends.items():
        if not high - low >= _SHORTEST_TRAVEL:
            raise ModelError(
                f"travel of {axis.lower()} must run from low to high by {_SHORTEST_TRAVEL:g} at least, not {low:g} to "
                f"{high:g}"
            )
    sign = spec.rotation_sign or rotation_sign
    if spec.random is not None:
        sizes = spec.random if random is None or "random" in spec.model_fields_set else random
        machine = random_machine(parsed, ends, seed if spec.seed is None else spec.seed, sizes, sign)
    else:
        machine = VirtualMachine(parsed, travel=ends, rotation_sign=sign)
    tables = []
    for name, table in spec.motions.items():
        if len(name) != 3 or name[-1] not in parsed.axes:
            raise ModelError(f"error motion {name!r}: the chain {text} has no such axis")
        tables.append((name, table.table()))
    line = error_motions.summed(machine.average_line, spec.average_line)
    machine = replace(machine, average_line=line, tool_offset=spec.tool_offset)
    return machine.with_errors(tables, spec.squareness)


def read_machine(path: Path | str) -> MachineSpec:
    """The machine described in a YAML file; a CalibrationError names the key or value that is wrong."""
    return read_record(Path(path), MachineSpec)


def read_record(path: Path, record: type[AnyRecord], unnamed: Container[object] = ()) -> AnyRecord:
    """A record from a YAML file; a CalibrationError names file, line and key. `unnamed` is as for `validated`."""
    document = read_yaml(path)
    if document.value is None:  # not what it was meant to say
        raise CalibrationError(f"{path}: the file is empty")
    return validated(record, document.value, str(path), document, unnamed=unnamed, refusal=CalibrationError)


def machine_document(machine: VirtualMachine) -> dict[str, Any]:
    """A machine's true errors as a document that `read_machine` accepts (one table per error motion)."""
    motions = {name: table for axis in machine.motions.values() for name, table in merged(axis).items()}
    return {
        "chain": str(machine.chain),
        "travel": {axis.lower(): list(ends) for axis, ends in machine.travel.items()},
        "rotation_sign": machine.rotation_sign,
        "random": None,
        "motions": {name: asdict(table) for name, table in motions.items()},
        "squareness": dict(machine.squareness),
        "average_line": dict(machine.average_line),
        "tool_offset": list(machine.tool_offset),
    }


def merged(axis: error_motions.AxisMotion) -> dict[str, error_motions.Table]:
    """One table per error motion; several of one name are summed on a fine common grid."""
    by_name: dict[str, list[error_motions.Table]] = {}
    for name, table in axis.tables:
        by_name.setdefault(name, []).append(table)
    out = {}
    for name, tables in by_name.items():
        if len(tables) == 1:
            out[name] = tables[0]
            continue
        nodes = np.unique(np.concatenate([table.nodes for table in tables]))
        kind = tables[0].interpolation
        if len({(table.nodes, table.interpolation) for table in tables}) > 1:
            fine = np.linspace(nodes[0], nodes[-1], _FINE)
            near = np.abs(fine[:, None] - nodes).min(axis=1) < (fine[1] - fine[0]) / 2.0
            nodes = np.sort(np.concatenate([nodes, fine[~near]]))
            kind = "periodic" if {table.interpolation for table in tables} == {"periodic"} else "linear"
        values = tuple(np.sum([table(nodes) for table in tables], axis=0).tolist())
        out[name] = error_motions.Table(tuple(nodes.tolist()), values, kind)
    return out
