"""What a model is a sum of: terms with named parameters and their columns."""

from __future__ import annotations

from dataclasses import dataclass

from machine_tool_calibration.arrays import Array

__all__ = ["Parameter", "Term"]


@dataclass(frozen=True)
class Parameter:
    """An unknown.

    Attributes:
        name: unique in the model.
        unit: SI, such as m, rad, m/s, 1/K, 1.
        low: smallest plausible value, if there is one.
        high: largest plausible value, if there is one.
        reference: what the unknown is counted from; the published value is reference plus unknown.
        shared: whether it belongs to the machine, so that several sessions have it in common.
    """

    name: str
    unit: str
    low: float | None = None
    high: float | None = None
    reference: float = 0.0
    shared: bool = False


@dataclass(frozen=True)
class Term:
    """A physical effect, or a group of unknowns of the method, evaluated for given readings.

    Attributes:
        name: what it is: an effect's id, an error motion, an instrument's unknown.
        parameters: k unknowns.
        columns: (k, n) change of each reading per unit of each unknown.
        field: (k, n, 3) displacement of the functional point per unit of each unknown, for a map of position errors;
            None for what changes the reading itself.
    """

    name: str
    parameters: tuple[Parameter, ...]
    columns: Array
    field: Array | None = None
