"""Sizes in a simulation that cannot be meant: metres taken for micrometres."""

from __future__ import annotations

from collections.abc import Iterator

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.simulation.flaws import find_flaw
from machine_tool_calibration.simulation.spec import SimulationSpec

__all__ = ["refuse_implausible"]

# Largest noise, spread and gross error of a reading that a measurement of machine tools can have, m.
_LARGEST = 1e-3
# How many times its typical size an effect may have.
_TIMES = 1e4


def refuse_implausible(spec: SimulationSpec) -> None:
    """Refuse lengths that were not meant in metres, and effects of an absurd size.

    Raises:
        CalibrationError: the first of them, with what may have been meant.
    """
    for name, value in _lengths(spec):
        if abs(value) > _LARGEST:
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
