"""Harmonics of an angle, for effects that repeat with a turn."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.effects.effect import Coefficient

__all__ = ["harmonic_coefficients", "harmonics"]


def harmonic_coefficients(orders: Iterable[int], limit: float) -> tuple[Coefficient, ...]:
    """Sine and cosine coefficients of each order, m, plausible up to a limit."""
    return tuple(Coefficient(f"{kind}{k}", "m", -limit, limit) for k in orders for kind in "sc")


def harmonics(angle: Array, orders: Iterable[int]) -> Array:
    """(2 k, n) sine and cosine of each order."""
    return np.array([wave(k * angle) for k in orders for wave in (np.sin, np.cos)])
