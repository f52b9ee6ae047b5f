# SPDX-License-Identifier: Apache-2.0
"""Noise with a memory is no effect, and no effect is noise with a memory."""

import numpy as np
import pytest

from machine_tool_calibration.arrays import Array, rms
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.planning.what_to_measure import Advice
from machine_tool_calibration.reports.verdict import verdict_words
from machine_tool_calibration.session.session import Session

from ... import plates
from ...estimation.test_serial_correlation import remembering

SIGMA, N = 1e-6, 400
TIME = 5.0 * np.arange(N)
WARM = 1.0 - np.exp(-TIME / 300.0)


def one_place(displacement: Array, declared: float = SIGMA) -> Session:
    """One place that is read again and again."""
    columns = dict(zip(("gx", "gy", "gz", "x", "y", "z"), np.zeros((6, N)), strict=True))
    columns |= {"gx": np.ones(N), "time": TIME, "displacement": displacement}
    return plates.session(columns, declared, "offset", ["EXX"], np.zeros(N, dtype=np.int64), "A")


@pytest.mark.parametrize("seed", range(3))
def test_it_is_no_effect_and_no_wave(seed: int) -> None:
    found = diagnose(one_place(SIGMA * remembering(np.random.default_rng(seed), N, 0.95)))
    assert (found.verdict, found.accepted, found.left) == ("adequate", (), ())
    assert found.search.memory == pytest.approx(39.0, rel=0.5)
    (words,) = (words for words in verdict_words(found, {}, Advice()) if "memory" in words)
    assert f"{found.search.memory:.0f} of them" in words


def test_an_effect_is_found_beside_it() -> None:
    noise = SIGMA * remembering(np.random.default_rng(1), N, 0.8)
    found = diagnose(one_place(noise + 15.0 * SIGMA * WARM))
    assert found.accepted == ("warmup_x",)
    assert found.search.memory == pytest.approx(9.0, rel=0.5)


def test_an_uncertainty_that_is_declared_too_large_is_no_memory() -> None:
    white = SIGMA * np.random.default_rng(1).normal(size=N)
    found = diagnose(one_place(white + 15.0 * SIGMA * WARM, 10.0 * SIGMA))
    assert found.search.memory == pytest.approx(1.0, abs=0.1)
    assert found.accepted == ("warmup_x",)


def test_u_of_what_is_slow_counts_it() -> None:
    size, away = 15.0 * SIGMA, []
    for seed in range(10):
        noise = SIGMA * remembering(np.random.default_rng(seed), N, 0.8)
        found = {p.name: p for p in identify(one_place(noise + size * WARM), effects=["warmup_x"]).parameters}
        away.append((found["warmup_x.a"].value - size) / found["warmup_x.a"].standard_uncertainty)
    assert 0.4 < rms(np.array(away)) < 1.3


@pytest.mark.parametrize(("declared", "widened"), [(1.0, True), (30.0, False)])
def test_u_is_no_larger_for_what_is_much_smaller_than_declared(declared: float, widened: bool) -> None:
    """An instrument may be off by as much as declared; what its readings share beside that says nothing of it."""
    session = one_place(SIGMA * remembering(np.random.default_rng(2), N, 0.8), declared * SIGMA)
    assert (identify(session).joint.marginal.memory_factor > 2.0) is widened


def test_a_missing_effect_is_no_memory() -> None:
    found = diagnose(one_place(SIGMA * np.random.default_rng(1).normal(size=N) + 2.0 * SIGMA * WARM))
    assert found.accepted == ("warmup_x",)
    assert found.search.memory == pytest.approx(1.0, abs=0.1)
