# SPDX-License-Identifier: Apache-2.0
"""The serial chain of a machine tool, from workpiece to tool (ISO 10791 order)."""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Chain:
    """Axes on the workpiece's side and on the tool's side of the bed."""

    workpiece_side: tuple[str, ...]  # axes from the workpiece to the bed
    tool_side: tuple[str, ...]  # axes from the bed to the tool
    # from the point to which the axes' positions refer to the functional point, x, y, z, m; it is part of every lever
    # arm (Abbe)
    tool_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def parse(cls, text: str) -> Chain:
        """Read a chain such as `w-X-Y-b-Z-t`; `V[w-C-A-b-Y-X-Z-(C)-t]` is accepted too.

        Axes in parentheses (a spindle) do not position and are left out. A ValueError if it is no chain from w through
        b to t, or names an axis twice.
        """
        match = re.fullmatch(r"(?:[A-Z]\[)?\s*w-(.*)-t\s*\]?", text.strip())
        inner = match.group(1).split("-") if match else []
        if inner.count("b") != 1:
            raise ValueError(f"chain {text!r} must run from w through one b to t, as in w-X-Y-b-Z-t")
        names = [name for name in inner if not re.fullmatch(r"\(.*\)", name)]
        bed = names.index("b")
        axes = names[:bed] + names[bed + 1 :]
        for name in axes:
            if name not in tuple("XYZABC"):
                raise ValueError(f"chain {text!r} has the unknown axis {name!r}; axes are X Y Z A B C")
        if len(set(axes)) < len(axes):
            raise ValueError(f"chain {text!r} names an axis twice")
        return cls(tuple(names[:bed]), tuple(names[bed + 1 :]))

    def __str__(self) -> str:
        """As `parse` reads it."""
        return "-".join(("w", *self.workpiece_side, "b", *self.tool_side, "t"))

    @property
    def axes(self) -> tuple[str, ...]:
        """All axes, from the workpiece to the tool."""
        return self.workpiece_side + self.tool_side

    @property
    def linear(self) -> tuple[str, ...]:
        """The linear axes, from the workpiece to the tool."""
        return tuple(axis for axis in self.axes if axis in "XYZ")

    @property
    def rotary(self) -> tuple[str, ...]:
        """The rotary axes, from the workpiece to the tool."""
        return tuple(axis for axis in self.axes if axis in "ABC")
