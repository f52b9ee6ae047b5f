# SPDX-License-Identifier: Apache-2.0
"""Which of several further measurements is proposed, from effects whose products are given by hand."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.effects.effect import Coefficient
from machine_tool_calibration.estimation import priors
from machine_tool_calibration.model.effect_sizes import smallest_signal
from machine_tool_calibration.planning.options import Option
from machine_tool_calibration.planning.sensing import Sensed
from machine_tool_calibration.planning.what_to_measure import Visibility, _separation, visibilities

PAIR = ("one", "other")


def pair(cosine: float, norm: float = 100.0, names: tuple[str, ...] = PAIR) -> Sensed:
    """Two effects of that norm outside the model, in standard uncertainties, at a signal of 2, and their cosine."""
    gram = norm**2 * np.array([[1.0, cosine], [cosine, 1.0]])
    place = {name: slice(k, k + 1) for k, name in enumerate(names)}
    return Sensed(gram, 2.0 * np.diag(gram), place, {name: np.array([2.0]) for name in names})


def option(kind: str, seconds: float, words: str = "") -> Option:
    nothing: Any = None
    words = words or f"{kind}, {seconds:g} s"
    return Option(kind=kind, measure=words, seconds=seconds, aside=f"besides {kind}", session=nothing, first_row=0)


def test_of_measurements_that_separate_well_the_quickest_is_proposed() -> None:
    tried = [
        (option("backwards", 100.0), pair(0.30)),
        (option("order", 20.0), pair(0.39)),
        (option("again", 1.0), pair(0.99)),
        (option("diagonal", 10.0), pair(0.41)),
    ]
    found = _separation(PAIR, pair(0.98), tried)
    assert found is not None
    assert (found.kind, found.measure, found.seconds, found.aside) == ("order", "order, 20 s", 20.0, "besides order")
    assert found.effects == PAIR
    assert (found.cosine_before, found.cosine_after) == pytest.approx((0.98, 0.39))
    # What the other cannot reproduce of a signal of twice the norm.
    assert found.apart_before == pytest.approx(200.0 * np.sqrt(1.0 - 0.98**2))
    assert found.apart_after == pytest.approx(200.0 * np.sqrt(1.0 - 0.39**2))
    assert found.separates


def test_where_none_separates_well_those_near_the_best_are_equal() -> None:
    tried = [
        (option("backwards", 100.0), pair(0.60)),
        (option("order", 20.0), pair(0.64)),
        (option("again", 1.0), pair(0.7)),
    ]
    found = _separation(PAIR, pair(0.98), tried)
    assert found is not None and found.kind == "order"
    # Of the same effort the first.
    alike = [(option("backwards", 20.0), pair(0.60)), (option("order", 20.0), pair(0.60))]
    found = _separation(PAIR, pair(0.98), alike)
    assert found is not None and found.kind == "backwards"


@pytest.mark.parametrize(("before", "after"), [(0.999, 0.95), (0.93, 0.89), (0.40, 0.38)])
def test_what_leaves_them_alike_or_hardly_changes_it_is_no_proposal(before: float, after: float) -> None:
    found = _separation(PAIR, pair(before), [(option("again", 1.0), pair(after))])
    assert found is not None
    assert found.kind is None and found.seconds is None and "none of the further measurements" in found.measure
    assert (found.cosine_before, found.cosine_after) == pytest.approx((before, after))
    assert not found.separates


def test_effects_that_a_measurement_does_not_sense_are_not_judged_by_it() -> None:
    alone = (option("again", 1.0), pair(0.0, names=("one", "third")))
    found = _separation(PAIR, pair(0.98), [alone])
    assert found is not None and found.kind is None and found.cosine_after == found.cosine_before
    assert _separation(("one", "fourth"), pair(0.98), []) is None


def test_the_first_of_a_group_counts_against_each_of_the_others() -> None:
    gram = np.array([[1.0, 0.6, 0.1], [0.6, 1.0, 0.99], [0.1, 0.99, 1.0]])
    names = ("a", "b", "c")
    place = {name: slice(k, k + 1) for k, name in enumerate(names)}
    three = Sensed(gram, np.ones(3), place, {name: np.ones(1) for name in names})
    found = _separation(names, three, [])
    assert found is not None
    assert found.cosine_before == pytest.approx(0.6)
    assert found.apart_before == pytest.approx(0.8)


SMALLEST = 1e-6


def seldom(
    now: float, *seen: tuple[str, float], rank: int = 1, detectable: bool = True, count: int = 1
) -> list[Visibility]:
    """An effect of that information now, of 1e6 in all, and with further measurements; readings scatter twofold."""

    def sensed(information: float) -> Sensed:
        gram = information * np.eye(count)
        return Sensed(gram, np.full(count, 1e6), {"play": slice(0, count)}, {"play": np.ones(count)})

    coefficients = tuple(Coefficient(f"b{k}", "m", -5e-5, 2e-5) for k in range(count))
    effect = SimpleNamespace(
        why_not=lambda observations: None, coefficients_for=lambda observations, shape: coefficients
    )
    fit = SimpleNamespace(variance=4.0, assembly=SimpleNamespace(models=[SimpleNamespace(observations=None)]))
    known = {"b0": SMALLEST} if detectable else {}
    findings = [SimpleNamespace(name="play", rank=rank, detectable=known)]
    diagnosis: Any = SimpleNamespace(fits=[fit], search=SimpleNamespace(findings=findings))
    assumed: Any = {"play": SimpleNamespace(effect=effect, shape=())}
    options = [(option("swing", 60.0, words), sensed(information)) for words, information in seen]
    return visibilities(diagnosis, sensed(now), options, assumed)


def test_what_shows_an_effect_shows_it_by_the_root_of_its_information() -> None:
    (found,) = seldom(1e3, ("much", 1e5))
    assert found == Visibility(
        effect="play", coefficient="b0", unit="m", before=SMALLEST, after=found.after,
        kind="swing", measure="much", seconds=60.0, aside="besides swing",
    )  # fmt: skip
    assert found.after == pytest.approx(0.1 * SMALLEST)


def test_more_trouble_must_be_worth_it() -> None:
    (found,) = seldom(1e3, ("simple", 1e5), ("a little better", 1.29e5))
    assert found.measure == "simple"
    (found,) = seldom(1e3, ("simple", 1e5), ("clearly better", 1.31e5))
    assert found.measure == "clearly better"
    assert found.after == pytest.approx(SMALLEST / np.sqrt(131.0))


def test_an_effect_that_shows_already_or_hardly_better_gets_no_proposal() -> None:
    assert seldom(1.02e4, ("much", 1e6)) == []  # a tenth of its norm is outside the model
    assert seldom(9.8e3, ("much", 1e6)) != []
    assert seldom(1e3, ("a little", 3.9e3)) == []  # half the size is worth it
    assert seldom(1e3, ("a little", 4.1e3)) != []
    assert seldom(1e3, ("much", 1e6), count=4) == []


def test_an_absorbed_effect_is_promised_by_what_would_be_accepted() -> None:
    """Its largest size is 50 um, half of it what is expected; the readings scatter by twice what was declared."""
    information = 1e13
    strength = np.array([information * 2.5e-5**2 / 4.0])
    signal = smallest_signal(strength, float(strength[0]), -np.log(priors.EFFECT))
    (found,) = seldom(0.0, ("both ways", information), rank=0, detectable=False)
    assert found.before is None
    assert found.after == pytest.approx(2.0 * signal / np.sqrt(information))
    assert seldom(0.0, ("hardly", 1e4), rank=0, detectable=False) == []  # larger than any could be
    assert seldom(0.0, ("not at all", 0.0), rank=0, detectable=False) == []
