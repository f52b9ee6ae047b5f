# SPDX-License-Identifier: Apache-2.0
"""The limit of deviations, by the tails of all."""

from __future__ import annotations

import numpy as np
import pytest

from machine_tool_calibration.residuals.tails import limit_of_tails


@pytest.mark.parametrize("seed", range(20))
def test_noise_is_not_taken_for_one_with_longer_tails(seed: int) -> None:
    """As many residuals as a session has: the limit of their deviations is that of normal ones."""
    size = np.abs(np.random.default_rng(seed).standard_normal(300))
    size *= 0.6745 / np.median(size)
    assert limit_of_tails(size, 0.002, 1.0, part=False) < 5.0


def test_longer_tails_of_a_part_are_seen() -> None:
    size = np.abs(np.random.default_rng(1).standard_t(4.0, 1000))
    size *= 0.6745 / np.median(size)
    assert limit_of_tails(size, 0.002, 1.0, part=True) > 10.0
