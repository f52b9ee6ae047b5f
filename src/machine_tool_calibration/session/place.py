"""How messages name the parts of a measurement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

__all__ = ["Place"]


@dataclass(frozen=True)
class Place:
    """Names of a measurement's parts, for messages.

    Attributes:
        description: what holds the description, such as the path of `session.yaml`.
        readings: what holds the readings, such as the path of `observations.csv`.
        line: line in the file for a row, where the readings are a text file.
    """

    description: str
    readings: str
    line: Callable[[int], int] | None = None

    def row(self, row: int) -> str:
        """`file row 3 (line 5)`; rows count from 0, lines from 1."""
        where = f"{self.readings} row {row}"
        return where if self.line is None else f"{where} (line {self.line(int(row))})"
