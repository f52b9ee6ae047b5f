# SPDX-License-Identifier: Apache-2.0
"""The stated uncertainties are those of the errors."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.methods.identify import identify


def _judged(rotary: SimpleNamespace, runs: int, **plan: object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors against the truth, stated uncertainties, and reduced chi-squares, over many runs."""
    errors, stated, chi = [], [], []
    for seed in range(runs):
        simulated = rotary.measured(seed, **plan)  # type: ignore[arg-type]
        result = identify(simulated.session)
        angles = np.asarray(result.error_map.content["c"])
        value, uncertainty = rotary.found(result.error_map.content)
        sign = simulated.session.rotation_sign
        truth = np.where(np.isfinite(value), rotary.true_motions(simulated, angles), np.nan)
        errors.append(rotary.without_datum(value, angles, sign) - rotary.without_datum(truth, angles, sign))
        stated.append(uncertainty)
        chi.append(result.fit.joint.reduced_chi_square)
    return np.array(errors), np.array(stated), np.array(chi)


def test_normalised_errors_over_many_runs(rotary: SimpleNamespace, many: Any) -> None:
    errors, stated, chi = _judged(rotary, many.count)
    assert np.mean((errors / stated) ** 2) == pytest.approx(1.0, abs=many.off(0.055))
    assert chi.mean() == pytest.approx(1.0, abs=many.off(0.03))
    # As small as the Cramer-Rao bound, motion by motion.
    ratio = np.sqrt(np.mean(errors**2, axis=(0, 2)) / np.mean(stated**2, axis=(0, 2)))
    assert (ratio < 1.0 + many.off(0.1)).all()


@pytest.mark.parametrize("plan", [{"repeats": 3}, {"both_ways": True, "sign": -1}, {"missing": 0.05}])
def test_variants_over_some_runs(rotary: SimpleNamespace, plan: dict[str, object], many: Any) -> None:
    some = many.part(0.4)
    errors, stated, chi = _judged(rotary, some.count, **plan)
    assert np.nanmean((errors / stated) ** 2) == pytest.approx(1.0, abs=some.off(0.067))
    assert chi.mean() == pytest.approx(1.0, abs=some.off(0.03))


def test_repeats_lower_the_uncertainty_by_their_root(reproducible: None, rotary: SimpleNamespace) -> None:
    one = identify(rotary.measured(1).session).error_map.content
    four = identify(rotary.measured(1, repeats=4).session).error_map.content
    for name in ("EXC", "EYC", "EZC", "EAC", "EBC", "ECC"):
        assert np.mean(one[f"{name}_u"]) / np.mean(four[f"{name}_u"]) == pytest.approx(2.0, rel=0.02)


def test_quarter_turn_is_weak_but_honest(rotary: SimpleNamespace, many: Any) -> None:
    some = many.part(0.4)
    errors, stated, _ = _judged(rotary, some.count, angles=tuple(np.linspace(0.0, np.pi / 2, 10)))
    assert np.mean((errors / stated) ** 2) == pytest.approx(1.0, abs=some.off(0.1))
    full = identify(rotary.measured(0).session).error_map.content
    assert np.mean(stated[:, 3]) > 3 * np.mean(full["EAC_u"])


def test_small_turn_does_not_claim_more_than_it_knows(rotary: SimpleNamespace, many: Any) -> None:
    some = many.part(0.4)
    errors, stated, _ = _judged(rotary, some.count, angles=tuple(np.linspace(0.0, np.pi / 6, 10)))
    assert np.mean((errors / stated) ** 2) < 1.0 + some.off(0.1)
    datum = identify(rotary.measured(0, angles=tuple(np.linspace(0.0, np.pi / 6, 10))).session).document()["datum"]
    assert "leave open stay where they are stated" in datum
