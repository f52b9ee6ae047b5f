# SPDX-License-Identifier: Apache-2.0
"""Sentences of an identification: how well the model fits, what shares a reason, and the figures of ISO 230-2.
One scatter is said with one number, and what runs share is not said to be what they do not reproduce.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.compare import compare
from machine_tool_calibration.diagnosis.diagnose import diagnose
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.result import only_if_right, scatter_p_value
from machine_tool_calibration.planning.what_to_measure import Advice
from machine_tool_calibration.reports.comparison import comparison_parts
from machine_tool_calibration.reports.goodness import scatter_words
from machine_tool_calibration.reports.identification import (
    datum_words,
    goodness_of_fit,
    group_by_reason,
    parameters_table,
    readings_set_aside,
    session_headline,
    spread_words,
    summary_rows,
)
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.reports.values import standard_tables
from machine_tool_calibration.reports.verdict import verdict_words
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.words import words

from .. import plates
from ..told import keys

RUN: dict[str, Any] = {
    "axis": "X", "setup": "x", "position": [0.0, 0.1, 0.2], "count_up": [2, 2, 2], "count_down": [2, 1, 2],
    "mean_up": [0.0, 1e-6, 4e-6], "mean_down": [None, -1e-6, None], "reversal": [None, 2e-6, None],
    "s_up": [3e-7] * 3, "s_down": [None] * 3, "B": 2.0e-6, "B_U": 0.5e-6, "M": 3.0e-6, "E_up": 4.0e-6,
}  # fmt: skip


@pytest.mark.parametrize(
    ("chi", "p", "key", "part"),
    [
        (1.0, 0.5, "fit.well", "p = 0.50"),
        (4.0, 1e-9, "fit.bad", "2.00"),
        (1.15, 0.007, "fit.nearly", "p = 0.007"),
        (0.25, 0.99999, "fit.too_well", "0.500"),
    ],
)
def test_goodness_of_fit(chi: float, p: float, key: str, part: str) -> None:
    text = goodness_of_fit({"reduced_chi_square": chi, "p_value": p})
    assert keys(text) == [key] and part in text


def test_a_scatter_is_said_with_its_own_ratio() -> None:
    # Passes that differ take the misfit up: uncertainties need no factor, and yet nothing is within what was declared.
    scatter = {"declared": 3e-7, "found": 5.46e-6, "uncertainties_from": "declared", "factor": 1.0}
    text = scatter_words({"scatter": scatter}, 0.0)
    assert keys(text)[0] == "fit.runs_differ" and "18.2" in text
    scatter = {"declared": 1e-6, "found": 1.51e-6, "uncertainties_from": "scatter", "factor": 1.48}
    text = scatter_words({"scatter": scatter}, 1e-9)
    assert keys(text)[0] == "fit.scatter_used" and "1.51 times" in text


def test_figures_of_a_run_stand_where_they_belong_and_few_runs_are_said() -> None:
    table, places = standard_tables({"iso230_2": [RUN]}, "iso230_2")
    assert isinstance(table, TextTable) and isinstance(places, TextTable)
    assert "2 up, 1 down" in table.title and "3 positions" in table.title
    rows = {row[0]: row[1:] for row in table.rows}
    assert set(rows) == {"reversal error B", "systematic deviation E", "mean deviation, range M"}
    assert rows["reversal error B"] == ("", "", "2.00 ± 0.50")
    assert rows["systematic deviation E"] == ("4.00", "–", "–")
    # U of a mean of two with s = 0.3 um is 0.4 um: two decimals.
    assert places.rows[1] == ("100", "1.00", "-1.00", "0.00", "2.00", "0.30", "–")
    assert keys(table.note) == ["iso230.few_runs"]
    few = {**RUN, "count_up": [1, 1, 1], "count_down": [0, 0, 0], "note": "U is from the runs alone."}
    table, _ = standard_tables({"iso230_2": [few]}, "iso230_2")
    assert isinstance(table, TextTable)
    assert keys(table.note) == ["iso230.repeatability_only", "iso230.one_run"]
    turned = {**RUN, "count_up": [0, 2, 2], "count_down": [2, 2, 0]}
    table, _ = standard_tables({"iso230_2": [turned]}, "iso230_2")
    assert isinstance(table, TextTable)
    assert "2 up, 2 down" in table.title and "1 positions" in table.title
    assert keys(table.note) == ["iso230.turned", "iso230.few_runs"]


def test_names_that_share_a_reason():
    assert group_by_reason([("a", "why"), ("b", "because"), ("c", "why")]) == [("why", "a, c"), ("because", "b")]
    assert group_by_reason((str(k), "lost") for k in range(20))[0][1].endswith("7 and 12 more")
    assert group_by_reason(((str(k), "lost") for k in range(20)), 20)[0][1].endswith("18, 19")


def test_the_datum_of_the_map_is_said_where_it_is_another_one() -> None:
    assert datum_words({"datum": "EXX(0) = 0", "error_map": {"datum": "no mean"}}) == "EXX(0) = 0; map: no mean"
    assert datum_words({"datum": "a; b", "error_map": {"datum": "a"}}) == "a; b"


def test_points_without_a_value_are_counted() -> None:
    error = [[1e-6, 2e-6, None], [1e-6, None, None], [0.0, 0.0, None]]
    document = {"used": 3, "observations": 3, "rms_residual": 0.0, "error_map": {"position_error": error}}
    rows = dict(summary_rows(document))
    assert rows["position error"].endswith("; not determined along z; along y not at 1 of 3 points")


def test_the_place_of_a_reading_set_aside_is_said_in_the_language() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["rotary_axis"], seed=4)).session
    table = readings_set_aside({"rejected": [{"row": 3, "reason": "", "deviation": 1e-6}]}, [session])
    place = table.rows[0][table.columns.index("position, mm or °")]
    target = session.readings.labels["target"][3]
    assert place.startswith(f"target {target}, C ") and words("de").told(place).startswith(f"Ziel {target}, C ")


def simulated(preset: str, *effects: str, seed: int = 4) -> Session:
    flaws = tuple(FlawSpec(id=name, amplitude=2e-6) for name in effects)
    return simulate(SimulationSpec(plan=PRESETS[preset], seed=seed, effects=flaws)).session


def told(session: Session) -> Iterator[str]:
    """What is said of a run's scatter before and after its reversal is in the model, and by whom."""
    for effects in ((), ("backlash_x",)):
        yield goodness_of_fit(identify(session, effects=effects).document())
        yield next(part for part in comparison_parts(compare(identify(session, effects=effects))) if "scatter" in part)  # type: ignore[operator, misc]
    yield " ".join(verdict_words(diagnose(session), {}, Advice()))


@pytest.mark.long
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
    of_map = {"position_error_u": [[1e-6, None, None]]}
    content = {"scatter": scatter, **of_map}
    assert only_if_right(1e-12, content) is (own is None)
    assert scatter_p_value(1e-12, content) == (own or 1e-12)
    said = str(scatter_words(content, 1e-12))
    assert words in said and ("reversal error" in said) is (own is not None)
    assert "reversal" not in str(scatter_words(of_map | {"scatter": scatter | {"found": 3.6e-7}}, 1e-12))
    # A model that leaves less than one direction scatters, as it has what changed from run to run, is judged by that.
    assert "scatter 0.250 µm" in str(scatter_words(of_map | {"scatter": scatter | {"found": 2.5e-7}}, 0.5))


def test_what_does_not_reproduce_has_a_bound_only_where_the_model_fits() -> None:
    whole, lacking = (identify(simulated("tracking_2d", *effects)) for effects in ((), ("backlash_y",)))
    assert any("at most" in words for words in spread_words(whole.document()))
    assert only_if_right(lacking.joint.p_value, lacking.error_map.content)
    assert not any("at most" in words for words in spread_words(lacking.document()))


def test_setups_of_which_nothing_was_read_are_not_counted() -> None:
    session = simulate(SimulationSpec(plan=PRESETS["step_diagonal"], seed=1)).session
    one = session.with_readings(session.readings.select(session.readings.setup == 0))
    assert f"in 1 setup ({session.setup_ids[0]})" in session_headline(one)


def test_sizes_that_are_drawn_to_usual_ones_are_said_beside_those_that_the_residual_belongs_to() -> None:
    """A drift of a third of a metre an hour, in readings that scatter by millimetres."""
    rng, time = np.random.default_rng(0), np.linspace(0.0, 90.0, 40)
    columns = {"x": 0.0, "y": 0.0, "z": 0.0, "time": time}
    drifted = columns | {"displacement": -1e-4 * time + 4e-3 * rng.normal(size=40)}
    result = identify(plates.session(drifted, 1e-3, "offset"), effects=["linear_drift"])
    note = parameters_table(result.document(), result.joint).note
    assert note.startswith("least squares alone would give linear_drift.r = -3")
    sharp = columns | {"displacement": -1e-9 * time + 1e-9 * rng.normal(size=40)}
    result = identify(plates.session(sharp, 1e-9, "offset"), effects=["linear_drift"])
    assert parameters_table(result.document(), result.joint).note == ""


def test_operators_that_differ_at_the_same_places_are_no_scatter_of_the_part() -> None:
    """Three operators read ten parts twice: what one of them sees otherwise is of part and operator."""
    rng = np.random.default_rng(2)
    setup, part = (k.ravel() for k in np.meshgrid(np.repeat([0, 1, 2], 2), np.arange(10), indexing="ij"))
    form, seen = 200e-6 * rng.normal(size=10), 90e-6 * rng.normal(size=(3, 10))
    columns = {"x": 0.01 * part} | {key: 0.0 * part for key in ("y", "z", "gx", "gy")} | {"gz": np.ones(60)}
    columns["displacement"] = form[part] + seen[setup, part] + 35e-6 * rng.normal(size=60)
    session = plates.session(
        columns, 40e-6, "offset", ["EZX"], np.tile(np.repeat([0, 1], 10), 3), "a", "b", "c", setup=setup
    )
    text = " ".join(verdict_words(diagnose(session), {}, Advice()))
    assert "the same place differs by more from setup to setup" in text
    assert "the scatter of the part" not in text
