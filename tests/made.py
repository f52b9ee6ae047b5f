# SPDX-License-Identifier: Apache-2.0
"""Simulated sessions, and sessions that differ from another in one thing."""

from dataclasses import replace
from typing import Any

import numpy as np

from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

__all__ = ["measured", "moved", "with_columns"]


def measured(plan: Any, seed: int = 0, *effects: FlawSpec, **more: Any) -> Session:
    """A simulated session of a plan, or of the preset of that name."""
    chosen = PRESETS[plan] if isinstance(plan, str) else plan
    return simulate(SimulationSpec(plan=chosen, seed=seed, effects=effects, **more)).session


def moved(session: Session, change: np.ndarray) -> Session:
    """The session with its readings changed by so much, (n,) m."""
    return session.with_readings(replace(session.readings, displacement=session.readings.displacement + change))


def with_columns(session: Session, **columns: np.ndarray) -> Session:
    """The session with these columns in place of its own or besides them."""
    return session.with_readings(replace(session.readings, columns={**session.readings.columns, **columns}))
