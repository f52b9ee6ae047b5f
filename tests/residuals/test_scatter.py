# SPDX-License-Identifier: Apache-2.0
"""From where on readings scatter more: said where nothing else is the cause, and not of single wrong ones."""

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.methods.fitted import FitRequest, fit_sessions
from machine_tool_calibration.planning.what_to_measure import Advice
from machine_tool_calibration.reports.verdict import verdict_words
from machine_tool_calibration.residuals.scatter import ScatterChange, scatter_change
from machine_tool_calibration.session.session import Session

from .. import plates


def measured(seed: int, sizes: np.ndarray, tails: float = 1e6) -> Session:
    """One place read again and again, with a scatter of its own each time, in standard uncertainties."""
    n = len(sizes)
    read = 1e-6 * sizes * np.random.default_rng(seed).standard_t(tails, n)
    columns = {"x": np.full(n, 0.1), "time": 8.0 * np.arange(n)}
    return plates.session(columns | {"displacement": read}, 1e-6, "none", ["EXX"], np.arange(n), repeats=n)


def change(session: Session, memory: float = 1.0) -> ScatterChange | None:
    return scatter_change(fit_sessions(FitRequest.of(session)).joint.fits[0], memory)


@pytest.mark.parametrize("factor", [4.0, 0.25])
def test_a_scatter_that_changes(factor: float) -> None:
    sizes = np.where(np.arange(150) < 90, 1.0, factor)
    for seed in range(5):
        found = change(measured(seed, sizes))
        assert found is not None and abs(found.row - 90) <= 15 and found.ratio == pytest.approx(factor, rel=0.5)


def test_scatter_that_is_alike_is_none_whatever_its_tails() -> None:
    for tails in (1e6, 3.0):
        assert not any(change(measured(seed, np.ones(120), tails)) for seed in range(40))
    single = np.ones(120)
    single[[100, 110, 115]] = 40.0
    assert not any(change(measured(seed, single)) for seed in range(20))


def test_few_readings_tell_nothing() -> None:
    assert change(measured(0, np.where(np.arange(15) < 8, 1.0, 30.0))) is None


def test_readings_that_are_alike_tell_less() -> None:
    session = measured(1, np.where(np.arange(100) < 50, 1.0, 6.0))
    assert change(session) is not None and change(session, 20.0) is None


def test_a_verdict_says_it_where_nothing_else_is_the_cause() -> None:
    told = list(verdict_words(diagnose(measured(2, np.where(np.arange(150) < 90, 1.0, 4.0))), {}, Advice()))
    assert [words.key for words in told if getattr(words, "key", "").startswith("fit.scatter_")] == [
        "fit.scatter_grows"
    ]
