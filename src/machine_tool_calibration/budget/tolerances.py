# SPDX-License-Identifier: Apache-2.0
"""Tolerances as people state them: on a command line with their unit, or in a YAML file."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from machine_tool_calibration.budget.published import unit_of
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.session.parse import parse_record
from machine_tool_calibration.session.record import Record
from machine_tool_calibration.session.text import read_text
from machine_tool_calibration.session.values import Finite
from machine_tool_calibration.units import quantity

_LARGEST = 0.1  # m or rad: a tolerance beyond is of another unit


class _File(Record):
    """What a file of tolerances holds: by figure, a text with its unit or a number in m or rad."""

    format: Literal["mtcal-tolerances/1"]
    tolerances: Annotated[dict[str, Finite | str], Field(min_length=1)]


def parse_tolerances(texts: Iterable[str]) -> dict[str, float]:
    """Tolerances in m and rad from `EXX=10um` …; a SessionError: no such unit, a ModelError: another form, twice."""
    out: dict[str, float] = {}
    for text in texts:
        name, sign, value = (part.strip() for part in text.partition("="))
        if not sign or not name:
            raise ModelError(f"the tolerance {text!r} is not of the form NAME=VALUE with a unit, such as EXX=10um")
        if name in out:
            raise ModelError(f"{name} has two tolerances")
        out[name] = tolerance(name, value)
    return out


def read_tolerances(path: Path) -> dict[str, float]:
    """Tolerances in m and rad from a YAML file; a SessionError says what is wrong in it and where."""
    content = parse_record(read_text(path), str(path), _File).tolerances
    return {name: tolerance(name, value, f"{path}: ") for name, value in content.items()}


def tolerance(name: str, value: float | str, source: str = "") -> float:
    """A tolerance in m or rad, from a number of these or a text with its unit; `source` begins a message.

    A SessionError: a text without a unit, or of another dimension; a ModelError: neither a number nor a text, or it is
    not positive.
    """
    if isinstance(value, bool) or not isinstance(value, str | float | int):
        raise ModelError(f"{source}the tolerance of {name} must be a number or a text with its unit")
    wanted = "angle" if unit_of(name) == "rad" else "length"
    found = quantity(value, wanted, f"{source}tolerance of {name}") if isinstance(value, str) else float(value)
    if not found > 0.0:
        raise ModelError(f"{source}the tolerance of {name} must be positive, not {found:g}")
    if found > _LARGEST:
        unit, small = ("rad", "urad") if wanted == "angle" else ("m", "um")
        given = "" if isinstance(value, str) else f"; a number is in {unit}: write the unit, as in {found:g}{small}"
        raise ModelError(f"{source}the tolerance of {name} is {found:g} {unit}, which no machine needs{given}")
    return found
