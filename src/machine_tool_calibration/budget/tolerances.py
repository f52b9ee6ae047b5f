# SPDX-License-Identifier: Apache-2.0
"""Tolerances as people state them: on a command line with their unit, or in a YAML file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from machine_tool_calibration.budget.conformity import unit_of_figure
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.importing.units import quantity
from machine_tool_calibration.session.description import Finite, Record
from machine_tool_calibration.session.parse import parse_record
from machine_tool_calibration.session.text import read_text

__all__ = ["parse_tolerances", "read_tolerances"]

FORMAT = "mtcal-tolerances/1"


class _File(Record):
    """What a file of tolerances holds: by figure, a text with its unit or a number in m or rad."""

    format: Literal["mtcal-tolerances/1"]
    tolerances: Annotated[dict[str, Finite | str], Field(min_length=1)]


def parse_tolerances(texts: Iterable[str]) -> dict[str, float]:
    """Tolerances in m and rad from texts such as `EXX=10um` and `C0Y=20urad`.

    Raises:
        SessionError: no unit, or one of another dimension.
        ModelError: not of that form, or one name twice.
    """
    out: dict[str, float] = {}
    for text in texts:
        name, sign, value = (part.strip() for part in text.partition("="))
        if not sign or not name:
            raise ModelError(f"the tolerance {text!r} is not of the form NAME=VALUE with a unit, such as EXX=10um")
        if name in out:
            raise ModelError(f"{name} has two tolerances")
        out[name] = _value(name, value)
    return out


def read_tolerances(path: Path) -> dict[str, float]:
    """Tolerances in m and rad from a YAML file.

    Raises:
        SessionError: it cannot be read, or something in it is wrong; one line that says what and where.
    """
    content = parse_record(read_text(path), str(path), _File, FORMAT).tolerances
    return {
        name: _value(f"{path}: {name}", value, name) if isinstance(value, str) else float(value)
        for name, value in content.items()
    }


def _value(what: str, text: str, name: str = "") -> float:
    return quantity(text, "angle" if unit_of_figure(name or what) == "rad" else "length", f"tolerance of {what}")
