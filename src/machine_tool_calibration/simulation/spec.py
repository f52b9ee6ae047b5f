# SPDX-License-Identifier: Apache-2.0
"""What to simulate: plan, machine, flaws and noise; from a file, or from what is said on a command line."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.session.record import Finite, NotNegative, Positive, Record, validated
from machine_tool_calibration.session.text import load_yaml
from machine_tool_calibration.simulation.circle_run import CirclePlan
from machine_tool_calibration.simulation.diagonal_run import DiagonalPlan
from machine_tool_calibration.simulation.direct_run import DirectPlan
from machine_tool_calibration.simulation.flaw import ALL_METHODS
from machine_tool_calibration.simulation.flaws import find_flaw
from machine_tool_calibration.simulation.machine_file import MachineSpec, build_machine, read_machine, read_record
from machine_tool_calibration.simulation.probing_run import ProbingPlan
from machine_tool_calibration.simulation.rotary_run import RotaryPlan
from machine_tool_calibration.simulation.tracking_run import TrackingPlan

AnyPlan = Annotated[
    TrackingPlan | DiagonalPlan | RotaryPlan | ProbingPlan | DirectPlan | CirclePlan, Field(discriminator="method")
]

PLANS = {
    str(plan.model_fields["method"].default): plan
    for plan in (DiagonalPlan, TrackingPlan, RotaryPlan, ProbingPlan, DirectPlan, CirclePlan)
}
"""The plan's class of each method."""

_FIFTH = (0.0, 0.02, 0.04, 0.06, 0.08, 0.1)

PRESETS: Mapping[str, AnyPlan] = {
    "tracking_2d": TrackingPlan(dimension=2),
    "tracking_3d": TrackingPlan(dimension=3),
    # 20 targets 20 mm apart on the edges of a square of 100 mm, three stations around it (the paper's Fig. 10; where
    # they stand is not printed: the first is 0.327 m from (100, 100), as Table 4 has 35.2 urad for 11.5 um there)
    "paper_003": TrackingPlan(
        dimension=2,
        stations=((-0.223, 0.05, 0.0), (0.05, -0.3, 0.0), (0.3, 0.28, 0.0)),
        points=tuple(
            [(x, 0.0, 0.0) for x in _FIFTH]
            + [(0.1, y, 0.0) for y in _FIFTH[1:]]
            + [(x, 0.1, 0.0) for x in _FIFTH[-2::-1]]
            + [(0.0, y, 0.0) for y in _FIFTH[-2:0:-1]]
        ),
        repeats=3,
        order="same",
    ),
    "step_diagonal": DiagonalPlan(),
    "step_diagonal_long": DiagonalPlan(
        step=(0.05, 0.05, 0.05), blocks=12, repeats=1, offset_linear=("xy", "xz", "yx", "yz", "zx", "zy")
    ),
    "step_diagonal_three_orders": DiagonalPlan(orders=("xyz", "yzx", "zxy"), repeats=1),
    "rotary_axis": RotaryPlan(),
    "rotary_axis_one_way": RotaryPlan(both_ways=False),
    "probing_cross": ProbingPlan(part="cross"),
    "probing_pins": ProbingPlan(part="pins"),
    "probing_cam": ProbingPlan(part="cam"),
    "probing_disc": ProbingPlan(part="disc"),
    "iso230_2": DirectPlan(kind="iso230_2", repeats=5),
    "straightness": DirectPlan(kind="straightness", repeats=3),
    "grid_plate": DirectPlan(kind="grid_plate", count=11, repeats=2, end=0.2),
    "ball_bar": CirclePlan(),
    "ball_bar_three_planes": CirclePlan(planes=("XY", "YZ", "ZX")),
    "drilled_plate": DirectPlan(kind="drilled_plate", count=16, end=0.45, noise=1e-6, interval=20.0),
}
"""Named plans: those of the papers and of the usual tests."""


_LARGEST_ERROR = 1e-3  # largest noise, spread and gross error of a reading that a measurement can have, m
_TIMES = 1e4  # how many times its typical size an effect may have, and noise its declared one


def refuse_implausible(spec: SimulationSpec) -> None:
    """Refuse lengths that were not meant in metres, and effects of an absurd size; say what may have been meant."""
    for name, value in _lengths(spec):
        if abs(value) > _LARGEST_ERROR:
            meant = f"did you mean {value * 1e-6:.3g}, which is {value:.3g} µm?"
            raise CalibrationError(f"{name}: {value:g} m is implausible; lengths are in metres: {meant}")
    for effect in spec.effects:
        if effect.size is None:
            continue
        flaw = find_flaw(effect.id)
        if flaw.typical and abs(effect.size) > _TIMES * abs(flaw.typical):
            unit = "" if flaw.unit == "1" else f" {flaw.unit}"
            raise CalibrationError(
                f"effects: {effect.id}: size {effect.size:g}{unit} is implausible; it is usually about "
                f"{flaw.typical:g}{unit}"
            )


def _lengths(spec: SimulationSpec) -> Iterator[tuple[str, float]]:
    if spec.noise is not None:
        yield "noise", spec.noise
    yield "repeatability", spec.repeatability
    yield from ((f"spread.{name}", value) for name, value in spec.spread.model_dump().items())
    if spec.chips is not None:
        yield "chips.size", spec.chips.size
    yield from ((f"effects: {e.id}: amplitude", e.amplitude) for e in spec.effects if e.amplitude is not None)


_COMMA = re.compile(r",(?![^\[]*\])")  # not one inside a list


def read_spec(path: Path | str) -> SimulationSpec:
    """The simulation that a YAML file describes; a CalibrationError names file, line and key."""
    return read_record(Path(path), SimulationSpec, ALL_METHODS)


def parse_setting(text: str) -> tuple[str, Any]:
    """`key=value` with a value in YAML, such as `repeats=3` or `stations=[[0, 0, 0], [1, 0, 0]]`."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise CalibrationError(f"{text!r} is not KEY=VALUE")
    return key.strip(), load_yaml(value, f"the value of {key.strip()}").value


def parse_effect(text: str) -> dict[str, Any]:
    """`ID` or `ID:size=2e-6,tau=900` as the mapping of a `FlawSpec`; else CalibrationError."""
    name, _, rest = text.partition(":")
    spec: dict[str, Any] = {"id": name.strip()}
    parameters: dict[str, Any] = {}
    for part in filter(None, (p.strip() for p in _COMMA.split(rest))):
        key, value = parse_setting(part)
        (spec if key in ("size", "amplitude") else parameters)[key] = value
    return spec | ({"parameters": parameters} if parameters else {})


def spec_from(
    base: SimulationSpec | None,
    *,
    method: str | None = None,
    preset: str | None = None,
    plan: Mapping[str, Any] | None = None,
    machine: Path | str | None = None,
    effects: Sequence[Mapping[str, Any]] = (),
    fields: Mapping[str, Any] | None = None,
) -> SimulationSpec:
    """A spec from options, on top of one that was read from a file, if there is one.

    A plan by its preset, or else its method, with keys that differ; the YAML file of a machine's true errors; effects
    as mappings of `FlawSpec`, which add to the file's; and other fields that differ. A CalibrationError: an unknown
    preset or method, a value out of range or implausible, neither file nor method nor preset.
    """
    planned = _planned(base, method, preset)
    content: dict[str, Any] = base.model_dump(exclude_unset=True, exclude={"plan"}) if base is not None else {}
    turning = {find_flaw(str(effect["id"])).axis for effect in effects} - {""}
    if planned["method"] == "rotary_axis" and len(turning) == 1:
        planned = {"axis": turning.pop()} | planned  # an effect of a table about X or Y needs one
    content |= {"plan": planned | dict(plan or {}), **(fields or {})}
    if machine is not None:
        content["machine"] = read_machine(machine)
    if effects:
        content["effects"] = [*content.get("effects", ()), *effects]
    spec = validated(SimulationSpec, content, "", unnamed=ALL_METHODS, refusal=CalibrationError)
    if machine is not None:
        try:  # what the file says may be unfit only for the plan's chain
            build_machine(spec.machine, chain=spec.plan.chain, travel=spec.plan.travel(), random=spec.plan.errors())
        except CalibrationError as error:
            raise CalibrationError(f"{machine}: {error}") from None
    refuse_implausible(spec)
    return spec


def _planned(base: SimulationSpec | None, method: str | None, preset: str | None) -> dict[str, Any]:
    if preset is not None and preset not in PRESETS:
        raise CalibrationError(f"no preset {preset!r}; there are {', '.join(PRESETS)}")
    if method is not None and method not in PLANS:
        raise CalibrationError(f"no method {method!r}; there are {', '.join(PLANS)}")
    chosen = PRESETS[preset] if preset is not None else base.plan if base is not None else None
    if preset is not None and method not in (None, PRESETS[preset].method):
        raise CalibrationError(f"preset {preset} is of the method {PRESETS[preset].method}, not {method}")
    if method is not None and (chosen is None or chosen.method != method):
        return {"method": method}
    if chosen is None:
        raise CalibrationError("say what to simulate: a SPEC.yaml, --method or --preset")
    return chosen.model_dump(exclude_unset=True) | {"method": chosen.method}


class FlawSpec(Record):
    """One effect to put in."""

    id: str  # the catalogue's id (RESULT.md), or an `unlisted_…` one
    size: Finite | None = None  # coefficient of the effect's formula, in its unit; typical if neither is given
    # instead of the size: the largest change of any reading that the effect shall make, m
    amplitude: Annotated[float, Field(ge=1e-12, allow_inf_nan=False)] | None = None
    parameters: dict[str, Any] = Field(default_factory=dict)  # further coefficients (`tau`, `lead`, `phase`, …)

    @model_validator(mode="after")
    def _check(self) -> FlawSpec:
        if self.size is not None and self.amplitude is not None:
            raise ValueError(f"effect {self.id}: give either size or amplitude")
        return self


class Spread(Record):
    """Irreproducibility between mountings (stretches of one setup's readings): standard deviations, m."""

    offset: NotNegative = 0.0  # one shift of all readings (seen only where readings are absolute)
    slope: NotNegative = 0.0  # readings drift from -slope to +slope over the setup
    bow: NotNegative = 0.0  # a parabola over the setup, from +bow through -bow/2 to +bow

    @model_validator(mode="before")
    @classmethod
    def _of_number(cls, value: Any) -> Any:
        """One number is that of slope and bow."""
        return {"slope": value, "bow": value} if isinstance(value, int | float) else value


class Chips(Record):
    """Readings that are wrong by a gross amount: a chip under the stylus, a broken beam."""

    fraction: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = 0.02  # of all readings, each by chance
    size: Positive = 2e-5  # scale of the error, m: between one and three times this, outwards for a probe

    @model_validator(mode="before")
    @classmethod
    def _of_number(cls, value: Any) -> Any:
        """One number is the fraction."""
        return {"fraction": value} if isinstance(value, int | float) else value


class SimulationSpec(Record):
    """Everything that decides a simulated session; the same spec gives the same session."""

    plan: AnyPlan  # geometry and order of the readings; its `method` chooses the method
    # of all that is random. Machine, set-up, environment, effects and noise have their own streams: adding an effect
    # changes neither the machine nor the noise
    seed: Annotated[int, Field(ge=0)] = 0
    machine: MachineSpec = MachineSpec()  # true errors; random ones of a good machining centre if absent
    effects: tuple[FlawSpec, ...] = ()  # what is put in
    noise: Positive | None = None  # standard uncertainty of a reading, m, as declared; the method's usual one if absent
    # the actual noise over the declared one (0: no noise)
    noise_factor: Annotated[float, Field(ge=0, le=_TIMES, allow_inf_nan=False)] = 1.0
    repeatability: NotNegative = 0.0  # standard deviation of the machine's position at each visit, per coordinate, m
    spread: Spread = Spread()  # irreproducibility between setups
    chips: Chips | None = None  # gross errors
    missing: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)] = 0.0  # fraction of readings that are lost
    # factor on all changes of temperature, pressure and humidity
    environment_swing: Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)] = 1.0

    @property
    def method(self) -> str:
        """The measuring method."""
        return self.plan.method
