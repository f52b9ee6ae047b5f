# SPDX-License-Identifier: Apache-2.0
"""The catalogue of measuring methods, built-in ones and those of plugins, and the columns that each needs."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Collection
from functools import cache
from typing import TYPE_CHECKING

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.session.method import MethodSpec, load

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from machine_tool_calibration.session.description import Description
    from machine_tool_calibration.session.session import Session

ENTRY_POINT_GROUP = "machine_tool_calibration.methods"

METHODS = {
    "step_diagonal": "machine_tool_calibration.methods.step_diagonal.spec:SPEC",
    "tracking_interferometer": "machine_tool_calibration.methods.tracking.spec:SPEC",
    "rotary_axis": "machine_tool_calibration.methods.rotary_axis.spec:SPEC",
    "probing": "machine_tool_calibration.methods.probing.spec:SPEC",
    "direct": "machine_tool_calibration.methods.direct.spec:SPEC",
    "ball_bar": "machine_tool_calibration.methods.ball_bar.spec:SPEC",
}
"""Where each method's record stands."""


@cache
def _plugins() -> dict[str, MethodSpec]:
    """Methods of installed packages by name; a broken one is skipped with a warning."""
    from importlib.metadata import entry_points

    found: dict[str, MethodSpec] = {}
    for point in entry_points(group=ENTRY_POINT_GROUP):
        try:
            spec = _loaded(point)
        except Exception as error:
            warnings.warn(f"the method plugin {point.name!r} is skipped: {error}", stacklevel=2)
            continue
        found.setdefault(spec.name, spec)
    return found


def _loaded(point: EntryPoint) -> MethodSpec:
    spec = point.load()
    if not isinstance(spec, MethodSpec):
        raise TypeError("it is no MethodSpec")
    if spec.name in METHODS:
        raise ValueError(f"there is a method {spec.name!r} already")
    return spec


def method_names() -> tuple[str, ...]:
    """Names of all methods: the built-in ones, then those of plugins."""
    return (*METHODS, *_plugins())


@cache
def method_spec(name: str) -> MethodSpec:
    """The record of a method; a KeyError if there is no such method."""
    if name in METHODS:
        spec: MethodSpec = load(METHODS[name])
        return spec
    return _plugins()[name]


def spec_of(session: Session) -> MethodSpec:
    """What the package knows of a session's method."""
    return method_spec(session.description.method)


def require_columns(description: Description, columns: Collection[str], source: str) -> None:
    """Raise a SessionError that names the columns that are missing."""
    spec = method_spec(description.method)
    needed = spec.columns(description)
    if missing := [name for name in needed if name not in columns]:
        near = [other for name in missing for other in difflib.get_close_matches(name, columns, n=1, cutoff=0.75)]
        had = ", ".join(repr(name) for name in dict.fromkeys(near) if name not in needed)
        hint = f" (it has {had})" if had else ""
        names = ", ".join(map(repr, missing))
        words = f"the column {names} is" if len(missing) == 1 else f"the columns {names} are"
        raise SessionError(f"{source}: {words} missing, which {description.method} needs{hint}")
    if spec.any_axis and not any(axis in columns for axis in "xyzabc"):
        raise SessionError(f"{source}: no column of an axis position (x, y, z or c), which {description.method} needs")
