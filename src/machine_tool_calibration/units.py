# SPDX-License-Identifier: Apache-2.0
"""Units of foreign tables, to SI; nothing is taken for granted, a unit must be named."""

import math
import re
from collections.abc import Sequence

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.errors import SessionError

# Unit to its dimension, power of ten and factor. The power goes into the text: 123.4 mm is 0.1234 m to the last bit,
# which neither 123.4 * 0.001 nor 123.4 / 1000 is.
UNITS: dict[str, tuple[str, int, float]] = {
    "m": ("length", 0, 1.0), "mm": ("length", -3, 1.0), "um": ("length", -6, 1.0), "nm": ("length", -9, 1.0),
    "cm": ("length", -2, 1.0),
    "in": ("length", 0, 0.0254), "mil": ("length", -3, 0.0254), "uin": ("length", -6, 0.0254),
    "rad": ("angle", 0, 1.0), "mrad": ("angle", -3, 1.0), "urad": ("angle", -6, 1.0),
    "deg": ("angle", 0, math.pi / 180), "arcsec": ("angle", 0, math.pi / 648e3), "gon": ("angle", 0, math.pi / 200),
    "s": ("time", 0, 1.0), "ms": ("time", -3, 1.0),
    "min": ("time", 0, 60.0), "h": ("time", 0, 3600.0), "d": ("time", 0, 86400.0),
    "degC": ("temperature", 0, 1.0),
    "Pa": ("pressure", 0, 1.0), "hPa": ("pressure", 2, 1.0), "mbar": ("pressure", 2, 1.0), "kPa": ("pressure", 3, 1.0),
    "%": ("number", -2, 1.0), "1": ("number", 0, 1.0),
}  # fmt: skip
_SPELLINGS = {
    "µm": "um", "μm": "um", "micron": "um", "µrad": "urad", "μrad": "urad", "inch": "in", "thou": "mil",
    "µin": "uin", "μin": "uin", "°": "deg", "grad": "gon", "°C": "degC", "C": "degC", "sec": "s",
}  # fmt: skip
_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\d\s].*?)?\s*")
_LIKE_A_UNIT = re.compile(r"[^\W\d_]{1,4}")
_IN_NAME = re.compile(r"(.*)[\[(]\s*([^\])]+?)\s*[\])]\s*")


def spelled(unit: str, what: str = "") -> str:
    """The unit as it is named here; a SessionError, after `what` it is of, if it is unknown."""
    name = _SPELLINGS.get(unit.strip(), unit.strip())
    if name not in UNITS:
        comma = "; decimals have a point here" if unit.startswith(",") else ""
        raise SessionError(f"{what}unknown unit {unit!r}{comma}; known are {', '.join(UNITS)}")
    return name


def dimension(unit: str) -> str:
    """Length, angle, time, temperature, pressure or number."""
    return UNITS[spelled(unit)][0]


def si_values(texts: Sequence[str], unit: str) -> Array:
    """Numbers in a unit, written with a point, in m, rad, s, degrees Celsius, Pa or as numbers; `nan` is NaN."""
    _, power, factor = UNITS[spelled(unit)]
    values = np.array([_shifted(text, power) for text in texts], dtype=np.float64)
    return values if factor == 1.0 else values * factor


def _shifted(text: str, power: int) -> float:
    """A number times a power of ten, rounded once."""
    if not power or text == "nan":
        return float(text)
    digits, _, own = text.lower().partition("e")
    return float(f"{digits}e{int(own or 0) + power}")


def quantity(text: str, wanted: str, what: str) -> float:
    """A number with its unit, such as `1.5 um`, in SI; a SessionError if it is not of the wanted dimension."""
    if (match := _QUANTITY.fullmatch(text)) is None:
        raise SessionError(f"{what}: {text!r} is not a number with a unit, as in {_example(wanted)}")
    if (unit := match[2]) is None:
        if wanted not in ("number", "temperature"):
            raise SessionError(f"{what}: {text!r} has no unit, as in {_example(wanted)}")
        return float(match[1])
    if dimension(spelled(unit, f"{what}: ")) != wanted:
        raise SessionError(f"{what}: {text!r} is not of the dimension {wanted}, as in {_example(wanted)}")
    return float(si_values([match[1]], unit)[0])


def name_and_unit(column: str) -> tuple[str, str | None]:
    """A column's name and the unit that it ends with, as in `X [mm]`; as it is and None if none is known."""
    match = _IN_NAME.fullmatch(column)
    unit = "1" if match is None else _SPELLINGS.get(match[2], match[2])
    return (column, None) if match is None or unit not in UNITS or unit == "1" else (match[1].strip(), unit)


def unknown_unit(column: str) -> str | None:
    """What a column's name ends with in square brackets, if it looks like a unit and is none that is known."""
    match = _IN_NAME.fullmatch(column) if column.rstrip().endswith("]") else None
    return match[2] if match is not None and not name_and_unit(column)[1] and _LIKE_A_UNIT.fullmatch(match[2]) else None


def _example(wanted: str) -> str:
    return {"length": "1.5um", "angle": "30deg", "time": "2.5s", "pressure": "1013.2hPa"}.get(wanted, "20.5")
