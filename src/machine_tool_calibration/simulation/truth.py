"""What is behind a simulated session; it is for judging a result, never an input to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.simulation.flaw import Chosen
from machine_tool_calibration.simulation.machine import VirtualMachine
from machine_tool_calibration.simulation.machine_file import machine_document

__all__ = ["Truth"]


@dataclass(frozen=True)
class Truth:
    """The truth of a simulated session.

    Attributes:
        seed: of the simulation.
        machine: with all its errors, those of the effects included (extra error motions, squareness).
        effects: what was put in.
        clean: (n,) readings without noise, spread and gross errors, m, in the session's datum.
        signal: (n,) what the effects changed in the clean readings, m.
        outliers: rows with a gross error.
        datum: (n,) readings of the same number are changes since the first of them; None: absolute readings.
        judged: the method's own figures: `position_error` at `points`, `stations`, …
    """

    seed: int
    machine: VirtualMachine
    effects: tuple[Chosen, ...]
    clean: Array
    signal: Array
    outliers: IntArray
    datum: IntArray | None = None
    judged: Mapping[str, Any] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """The content of `truth.json`."""
        named = self.effects[0].flaw.id if self.effects else ("chips" if len(self.outliers) else None)
        return {
            "seed": self.seed,
            "effect": named,
            "amplitude": float(np.max(np.abs(self.signal), initial=0.0)),
            "effects": [chosen.document() for chosen in self.effects],
            **self.judged,
            "outliers": [int(row) for row in self.outliers],
            "machine": machine_document(self.machine),
        }
