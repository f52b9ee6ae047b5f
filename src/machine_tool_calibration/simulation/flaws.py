# SPDX-License-Identifier: Apache-2.0
"""Every flaw by its id."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from machine_tool_calibration.errors import CalibrationError, did_you_mean
from machine_tool_calibration.simulation.flaw import Chosen, Flaw
from machine_tool_calibration.simulation.flaws_position import POSITION_FLAWS, REVERSAL_FLAWS, THERMAL_FLAWS
from machine_tool_calibration.simulation.flaws_reading import READING_FLAWS
from machine_tool_calibration.simulation.flaws_unlisted import UNLISTED_FLAWS
from machine_tool_calibration.simulation.scene import Scene

__all__ = ["FLAWS", "choose_flaw", "find_flaw"]

FLAWS: Mapping[str, Flaw] = {
    flaw.id: flaw for flaw in (*POSITION_FLAWS, *REVERSAL_FLAWS, *THERMAL_FLAWS, *READING_FLAWS, *UNLISTED_FLAWS)
}


def find_flaw(name: str) -> Flaw:
    """The flaw of that id.

    Raises:
        CalibrationError: there is none; the message names those that are alike.
    """
    if name in FLAWS:
        return FLAWS[name]
    hint = did_you_mean(name, FLAWS) or f"; known are {', '.join(FLAWS)}"
    raise CalibrationError(f"no effect {name!r} can be simulated{hint}")


def choose_flaw(
    name: str,
    size: float | None = None,
    parameters: Mapping[str, Any] | None = None,
    seed: int | np.random.Generator = 0,
    scene: Scene | None = None,
) -> Chosen:
    """A flaw with its size and parameters; what is not given is typical, or drawn from the seed.

    The `scene` is the readings it is meant for, where that matters (`unlisted_step` happens among them).

    Raises:
        CalibrationError: unknown effect or parameter.
    """
    flaw = find_flaw(name)
    drawn = dict(flaw.draw(np.random.default_rng(seed), scene)) if flaw.draw else {}
    settled = {**flaw.defaults, **drawn}
    for key, value in (parameters or {}).items():
        if key not in settled:
            known = ", ".join(settled) or "none"
            raise CalibrationError(f"effect {name} has no parameter {key!r}; its parameters are: {known}")
        settled[key] = value
    chosen = flaw.typical if size is None else float(size)
    if not np.isfinite(chosen):
        raise CalibrationError(f"effect {name}: the size must be a finite number")
    return Chosen(flaw, chosen, settled)
