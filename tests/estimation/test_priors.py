# SPDX-License-Identifier: Apache-2.0
"""What is believed before any reading are probabilities and sizes, in an order that makes sense."""

import pytest

from machine_tool_calibration.estimation import priors

NUMBERS = {name: value for name, value in vars(priors).items() if name.isupper()}
PROBABILITIES = (
    *("ALL_REPRODUCES", "EFFECT", "STRUCTURE", "RARE", "BULK", "JUDGED", "SINGLE", "ACCEPTED", "FURTHER", "MAY_BE"),
    *("LIKELY", "SURE", "ALIKE", "THE_SAME", "LAW", "ABSORBED", "DETECTED", "STRUCTURE_P", "LACK_OF_FIT_P"),
    *("CONTRADICTED_P", "MOST_OF_THE_EXCESS", "GOOD_ENOUGH", "SMALL", "COURSE", "CURVED", "AS_NOISY"),
)


def test_distributions_are_whole() -> None:
    for sizes in (priors.TAILS, priors.IMPERFECTION_SIZES):
        assert sum(sizes.values()) == pytest.approx(1.0)
        assert min(sizes.values()) > 0.0 <= min(sizes)
        assert sorted(sizes) == list(sizes)


@pytest.mark.parametrize("name", [name for name, value in NUMBERS.items() if not isinstance(value, dict)])
def test_every_number_is_positive_and_shares_are_less_than_one(name: str) -> None:
    values = NUMBERS[name] if isinstance(NUMBERS[name], tuple) else (NUMBERS[name],)
    assert all(value > 0.0 for value in values)
    assert name not in PROBABILITIES or max(values) < 1.0


def test_what_is_surer_is_asked_more_of() -> None:
    assert priors.MAY_BE < priors.LIKELY < priors.ACCEPTED < priors.FURTHER < priors.SURE
    assert priors.STRUCTURE < priors.EFFECT < priors.ALL_REPRODUCES
    assert priors.ALIKE < priors.THE_SAME and priors.SUSPECTED < priors.SUSPECTED_BESIDE < priors.WIDTH
    assert priors.AGREEING <= priors.NEIGHBOURS and priors.HARDLY_DECLARED_DOF < priors.DECLARED_DOF
