# SPDX-License-Identifier: Apache-2.0
"""Values that descriptions hold: numbers of a size that can have been measured, ids, instruments."""

from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field


def _check_identifier(text: str) -> str:
    """Only what comes back from a CSV field as it was."""
    if not text or len(text) > 256 or text != text.strip() or not text.isprintable() or text.lower() == "nan":
        raise ValueError(f"{text[:40]!r} cannot be an id: printable text without spaces at its ends, and not nan")
    return text


Identifier = Annotated[
    str,
    BeforeValidator(lambda v: str(v) if isinstance(v, int) and not isinstance(v, bool) else v),
    AfterValidator(_check_identifier),
]
LARGEST, SMALLEST = 1e12, 1e-100
"""Sizes between which numbers are in any SI unit here, if they are not 0: squares and cubes stay finite."""
_FEMTOMETRE = 1e-15


def _check_size(value: float) -> float:
    """Only what can have been measured."""
    if abs(value) > LARGEST or 0.0 < abs(value) < SMALLEST:
        raise ValueError(f"{value:g} is too {'large' if abs(value) > 1.0 else 'small'} to be anything of a machine")
    return value


def _check_sign(value: float) -> float:
    if value not in (-1.0, 0.0, 1.0):
        raise ValueError(f"{value:g} is no sign: -1, 0 or +1")
    return value


Finite = Annotated[float, Field(allow_inf_nan=False), AfterValidator(_check_size)]
Positive = Annotated[Finite, Field(gt=0), Field(ge=_FEMTOMETRE)]
"""A length or its uncertainty; no instrument resolves a femtometre."""
Sign = Annotated[Finite, AfterValidator(_check_sign)]
Vector3 = tuple[Finite, Finite, Finite]
Vector2 = tuple[Finite, Finite]


Instrument = Literal[
    "laser_interferometer", "tracking_interferometer", "laser_tracker", "ball_bar", "grid_encoder",
    "linear_encoder", "straightedge", "indicator", "autocollimator", "cmm", "touch_probe", "micro_switch",
]  # fmt: skip
"""What can read deviations directly."""
