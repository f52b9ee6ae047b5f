# SPDX-License-Identifier: Apache-2.0
"""Runs along X of which every published number is known in closed form."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.methods.fitted import FittedSessions, fit_sessions
from machine_tool_calibration.session.contributor import Contributor
from machine_tool_calibration.session.session import Session

from ..plates import session

NODES = np.array([0.0, 0.1, 0.2, 0.3, 0.4])


def _runs(deviation: Any = 0.0, *, runs: int = 4, datum: str = "none", terms: Any = ("EXX",), **said: Any) -> Session:
    """Deviations along X at five positions, run after run; EXX is their mean at each position."""
    n = runs * len(NODES)
    columns = {"x": np.tile(NODES, runs), "gx": np.ones(n), "gy": np.zeros(n), "gz": np.zeros(n)}
    columns |= {"time": np.arange(n) * 5.0, "y": np.zeros(n), "z": np.zeros(n)}
    columns["displacement"] = np.zeros(n) + deviation
    usual = {"machine": {"chain": "w-X-b-Z-t"}, "repeats": runs}
    return session(columns, 1e-6, datum, terms, np.repeat(np.arange(runs), len(NODES)), "X", **usual | said)


@pytest.fixture(scope="session")
def runs() -> Callable[..., Session]:
    """A session of runs along X; keys of its description may be said."""
    return _runs


@pytest.fixture(scope="session")
def fitted() -> FittedSessions:
    """Four runs without any deviation, fitted."""
    return fit_sessions(_runs())


@pytest.fixture(scope="session")
def contributor() -> Callable[..., Contributor]:
    """One line of a budget of 2 µm (or the unit's 2e-6); keys may be said."""

    def make(enters: str, varies: str, u: float = 2e-6, **said: Any) -> Contributor:
        size = {} if {"half_width", "expanded"} & set(said) else {"standard_uncertainty": u}
        return Contributor(name=f"{enters} by {varies}", type="B", enters=enters, varies=varies, **size, **said)

    return make
