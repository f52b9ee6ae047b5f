# SPDX-License-Identifier: Apache-2.0
"""One scatter is said with one number, and what runs share is not said to be what they do not reproduce."""

from collections.abc import Iterator

import pytest

from machine_tool_calibration.diagnosis.compare import compare
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.goodness import only_if_right, scatter_p_value
from machine_tool_calibration.planning.what_to_measure import Advice
from machine_tool_calibration.reports.comparison import comparison_parts
from machine_tool_calibration.reports.goodness import free_words, scatter_words
from machine_tool_calibration.reports.identification import goodness_of_fit, spread_words
from machine_tool_calibration.reports.verdict import verdict_words
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

from ..told import keys


def simulated(preset: str, *effects: str, seed: int = 4) -> Session:
    flaws = tuple(FlawSpec(id=name, amplitude=2e-6) for name in effects)
    return simulate(SimulationSpec(plan=PRESETS[preset], seed=seed, effects=flaws)).session


def told(session: Session) -> Iterator[str]:
    """What is said of a run's scatter before and after its reversal is in the model, and by whom."""
    for effects in ((), ("backlash_x",)):
        yield goodness_of_fit(identify(session, effects=effects).document())
        yield next(part for part in comparison_parts(compare(identify(session, effects=effects))) if "scatter" in part)  # type: ignore[operator, misc]
    yield " ".join(verdict_words(diagnose(session), {}, Advice()))


def test_a_run_by_iso_230_2_has_one_scatter_before_and_after_its_reversal_is_in_the_model() -> None:
    session = simulated("iso230_2", "backlash_x")
    size = f"{1e6 * identify(session).error_map.content['scatter']['one_direction']:.3f} µm"
    text = f"The readings of one direction agree within their declared uncertainty (scatter {size}"
    every = list(told(session))
    assert len(every) == 5 and all(text in one for one in every)
    assert all(f"Readings repeated at one place scatter {size}" in every[k] for k in (1, 3))
    assert "reversal error" in every[0] and "reversal error" not in every[2]


@pytest.mark.parametrize(
    ("own", "words"),
    [
        (0.5, "agree within their declared uncertainty (scatter 0.350 µm"),
        (0.01, "agree nearly within their declared uncertainty (scatter 0.350 µm"),
        (1e-9, "of one direction scatter 1.17 times their declared uncertainty (scatter 0.350 µm"),
        (None, "scatter 6.67 times their declared uncertainty about the model (scatter 2.00 µm"),
    ],
)
def test_a_run_is_judged_by_its_readings_of_one_direction(own: float | None, words: str) -> None:
    scatter = {"declared": 3e-7, "found": 2e-6, "uncertainties_from": "scatter", "factor": 6.0}
    if own is not None:
        scatter |= {"one_direction": 3.5e-7, "one_direction_p_value": own}
    content = {"scatter": scatter}
    assert only_if_right(1e-12, content) is (own is None)
    assert scatter_p_value(1e-12, content) == (own or 1e-12)
    said = str(scatter_words(content, 1e-12))
    assert words in said and ("reversal error" in said) is (own is not None)
    assert "reversal" not in str(scatter_words({"scatter": scatter | {"found": 3.6e-7}}, 1e-12))
    # A model that leaves less than one direction scatters, as it has what changed from run to run, is judged by that.
    assert "scatter 0.250 µm" in str(scatter_words({"scatter": scatter | {"found": 2.5e-7}}, 0.5))


def test_what_does_not_reproduce_has_a_bound_only_where_the_model_fits() -> None:
    whole, lacking = (identify(simulated("tracking_2d", *effects)) for effects in ((), ("backlash_y",)))
    assert any("at most" in words for words in spread_words(whole.document()))
    assert only_if_right(lacking.joint.p_value, lacking.error_map.content)
    assert not any("at most" in words for words in spread_words(lacking.document()))


def test_along_one_axis_the_free_model_is_told_where_places_outnumber_the_nodes() -> None:
    points = [[0.001 * k, 0.0, 0.0] for k in range(300)]
    content = {"points": points, "tables": {"EZX": {"nodes": points[::15]}}, "scatter": None}
    document = {"method": "direct", "model": "rigid_body", "p_value": 1e-12, "error_map": content}
    (text,) = free_words(document)
    assert keys(text) == ["fit.free_nodes"] and "20 nodes" in text and "300 places" in text
    # Each place that was approached from either side stands twice in a map.
    every = {**content, "points": points[:20] * 2}
    assert not list(free_words({**document, "error_map": every}))
    assert not list(free_words({**document, "p_value": 0.5}))
    wide = {**content, "points": [*points, [0.0, 0.1, 0.0]]}
    assert keys(next(free_words({**document, "error_map": wide}))) == ["fit.free"]
