# SPDX-License-Identifier: Apache-2.0
"""The catalogue of physical effects: built-in ones and those of plugins."""

import warnings
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from machine_tool_calibration.effects.backlash import Backlash, RotaryBacklash
from machine_tool_calibration.effects.dead_path import DeadPath
from machine_tool_calibration.effects.effect import AxisEffect, Effect
from machine_tool_calibration.effects.error_motion import ErrorMotionEffect
from machine_tool_calibration.effects.linear_drift import LinearDrift
from machine_tool_calibration.effects.lost_motion import LostMotion
from machine_tool_calibration.effects.mirror_misalignment import MirrorMisalignment
from machine_tool_calibration.effects.pitch_periodic import (
    PitchPeriodic,
    ReversalPeriodic,
    SecondPeriodic,
    StraightnessPeriodic,
)
from machine_tool_calibration.effects.pointer_axis_offset import PointerAxisOffset
from machine_tool_calibration.effects.pointer_radial_error import PointerRadialError
from machine_tool_calibration.effects.pointer_zero_offset import PointerZeroOffset
from machine_tool_calibration.effects.probe_pretravel import ProbePretravel
from machine_tool_calibration.effects.recorded import recorded_effect, recorded_effects
from machine_tool_calibration.effects.refractive_index import RefractiveIndex
from machine_tool_calibration.effects.retroreflector_form import RetroreflectorForm
from machine_tool_calibration.effects.reversal import REVERSALS, Reversal
from machine_tool_calibration.effects.reversal_spike import ReversalSpike
from machine_tool_calibration.effects.rotary_axis_drift import RotaryAxisDrift
from machine_tool_calibration.effects.scale import AxisScale, Scale
from machine_tool_calibration.effects.screw_growth import ScrewGrowth
from machine_tool_calibration.effects.servo_mismatch import ServoMismatch
from machine_tool_calibration.effects.squareness import Squareness
from machine_tool_calibration.effects.squareness_drift import SquarenessDrift
from machine_tool_calibration.effects.squareness_thermal import SquarenessThermal
from machine_tool_calibration.effects.station_drift import StationDrift
from machine_tool_calibration.effects.table_thermal_growth import TableThermalGrowth
from machine_tool_calibration.effects.thermal_expansion import ThermalExpansion
from machine_tool_calibration.effects.thermal_lag import ThermalLag
from machine_tool_calibration.effects.vibration import Vibration
from machine_tool_calibration.effects.warmup import Warmup
from machine_tool_calibration.effects.workpiece_thermal import WorkpieceThermal
from machine_tool_calibration.errors import ModelError, did_you_mean
from machine_tool_calibration.machine.error_motions import SQUARENESS, parse_motion
from machine_tool_calibration.session.table import NUMERIC_COLUMNS

ENTRY_POINT_GROUP = "machine_tool_calibration.effects"


_MOTIONS = tuple(f"E{component}{axis}" for axis in "XYZ" for component in "XYZABC")
_STRAIGHTNESS = tuple(name for name in _MOTIONS if parse_motion(name).is_straightness)
# The effects in their order, with the axes or errors of axes of which there is one each.
_BUILT_IN: tuple[tuple[type[AxisEffect], Iterable[str]] | type[Effect], ...] = (
    (Backlash, "xyz"), (RotaryBacklash, "abc"), (LostMotion, "xyz"),
    (Reversal, REVERSALS), (ReversalSpike, "xyz"), (ServoMismatch, "xyz"), (Vibration, "xyz"),
    (ThermalExpansion, "xyz"), (ThermalLag, "xyz"), (Warmup, "xyz"),
    (ScrewGrowth, "xyz"),
    (PitchPeriodic, "xyz"), (SecondPeriodic, "xyz"), (ReversalPeriodic, "xyz"), (StraightnessPeriodic, _STRAIGHTNESS),
    RefractiveIndex, DeadPath, LinearDrift, StationDrift,
    MirrorMisalignment, PointerRadialError, PointerZeroOffset,
    PointerAxisOffset, RetroreflectorForm,
    TableThermalGrowth, RotaryAxisDrift, WorkpieceThermal, ProbePretravel,
    Scale, (AxisScale, "xyz"), (ErrorMotionEffect, _MOTIONS),
    (Squareness, SQUARENESS), (SquarenessDrift, SQUARENESS), (SquarenessThermal, SQUARENESS),
)  # fmt: skip


@cache
def _built_in() -> tuple[Effect, ...]:
    each = (map(*entry) if isinstance(entry, tuple) else (entry(),) for entry in _BUILT_IN)
    return tuple(effect for own in each for effect in own)


@cache
def _plugins() -> tuple[Effect, ...]:
    """Effects of installed packages; a broken one is skipped with a warning."""
    found = []
    for point in entry_points(group=ENTRY_POINT_GROUP):
        try:
            effect = point.load()()
            if not isinstance(effect, Effect):
                raise TypeError("it does not make an Effect")
        except Exception as error:
            warnings.warn(f"the effect plugin {point.name!r} is skipped: {error}", stacklevel=2)
            continue
        found.append(effect)
    return tuple(found)


def catalogue(own: Sequence[Effect] = (), recorded: Sequence[str] = ()) -> dict[str, Effect]:
    """All effects by id: built-in, of plugins, of what was recorded, and the user's own; none replaces an earlier one.

    Columns of the sessions that no other effect takes have theirs. A ModelError if one of the user's own has the id of
    another effect.
    """
    out = {effect.id: effect for effect in _built_in()}
    for effect in _plugins():
        out.setdefault(effect.id, effect)
    if recorded:
        taken = {name for effect in out.values() for name in effect.needs}.difference(NUMERIC_COLUMNS)
        for effect in recorded_effects([name for name in recorded if name not in taken]):
            out.setdefault(effect.id, effect)
    mine = dict[str, Effect]()
    for effect in own:
        if effect.id in mine:
            raise ModelError(f"two effects of yours have the name {effect.id!r}")
        if effect.id in out:
            raise ModelError(f"the effect {effect.id!r} is in the catalogue already; give yours another name")
        mine[effect.id] = effect
    return out | mine


def find_effects(ids: Sequence[str], own: Sequence[Effect] = ()) -> list[Effect]:
    """The effects of these ids; a ModelError if one is unknown or named twice."""
    known = catalogue(own)
    for k, name in enumerate(ids):
        if name not in known and (of_recorded := recorded_effect(name)) is not None:
            known[name] = of_recorded
        if name not in known:
            hint = did_you_mean(name, known) or "; `mtcal effects` lists them"
            raise ModelError(f"unknown effect {name!r}{hint}")
        if name in ids[:k]:
            raise ModelError(f"the effect {name!r} is named twice")
    return [known[name] for name in ids]


def own_effects(files: Iterable[str | Path]) -> list[Effect]:
    """The user's own effects from their YAML files; empty names are passed over.

    A CalibrationError if a file cannot be read, or an effect is wrong.
    """
    named = [Path(file) for file in files if file]
    if not named:
        return []
    from machine_tool_calibration.effects.formula import read_effects  # loads pint, for few

    return [effect for file in named for effect in read_effects(file)]
