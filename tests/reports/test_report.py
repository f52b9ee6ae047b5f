# SPDX-License-Identifier: Apache-2.0
"""What people read: the verdict in plain words, and tables that hold what they say."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.consequence import consequences
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.planning.what_to_measure import what_to_measure
from machine_tool_calibration.reports.diagnosis import Report, diagnosis_report
from machine_tool_calibration.reports.quantities import quantity
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.reports.verdict import mounted_more_than_once
from machine_tool_calibration.simulation import PRESETS, Chips, FlawSpec, SimulationSpec, simulate

from ..diagnosed import diagnosed

SPECS = {
    "adequate": SimulationSpec(plan=PRESETS["tracking_2d"], seed=101),
    "missing_effect": SimulationSpec(
        plan=PRESETS["tracking_2d"], seed=77, effects=(FlawSpec(id="backlash_y", amplitude=1.5e-6),)
    ),
    "unexplained": SimulationSpec(
        plan=PRESETS["tracking_2d"], seed=6, effects=(FlawSpec(id="unlisted_cubic_path", amplitude=6e-6),)
    ),
    "outliers": SimulationSpec(plan=PRESETS["probing_cross"], seed=9, chips=Chips(fraction=0.02)),
    "too noisy": SimulationSpec(plan=PRESETS["tracking_2d"], seed=102, noise_factor=1.6),
    "too little to tell": SimulationSpec(
        plan=PRESETS["tracking_2d"], seed=19, effects=(FlawSpec(id="station_drift", amplitude=1.5e-6),)
    ),
}


@cache
def report(name: str) -> tuple[Diagnosis, Report]:
    found = diagnosed(SPECS[name])
    return found, diagnosis_report(found, what_to_measure(found), consequences(found))


def table(shown: Report, title: str) -> TextTable:
    return next(t for t in (*shown.tables, *shown.details) if t.title.startswith(title))


@pytest.mark.parametrize("name", list(SPECS))
def test_every_row_has_a_text_for_every_head(name: str) -> None:
    _, shown = report(name)
    for each in (*shown.tables, *shown.details):
        assert each.rows
        assert all(len(row) == len(each.columns) for row in each.rows)
        assert not any("nan" in cell.lower().split() for row in each.rows for cell in row)
    assert all("nan" not in words.split() for words in shown.words)


def test_adequate_says_so_first() -> None:
    _, shown = report("adequate")
    assert shown.words[0].startswith("Nothing is missing that this measurement could show")
    assert len(shown.words) == 1
    assert table(shown, "Smallest size").rows


def test_where_setups_may_differ_as_much_as_an_effect_would_the_likeliest_leads() -> None:
    found, shown = report("too little to tell")
    assert found.verdict == "adequate" and found.accepted == ()
    assert found.ranked[0].name == "station_drift"
    # That setups differ is said, with how much.
    (spread,) = (size for size in found.fits[-1].marginal.sizes if size.probability > 0.9)
    assert any(quantity(spread.size, "m") in words for words in shown.words)


def test_an_effect_found_is_told_with_its_size_and_what_it_does() -> None:
    found, shown = report("missing_effect")
    assert shown.words[0] == "The model lacks backlash of Y (backlash_y)."
    words = shown.words[1]
    for part in ("e_y = -b dir_y", "± ", "(k = 2)", "changes the readings by", "residual falls", "at the tool point"):
        assert part in words
    first = table(shown, "Effects looked for").rows[0]
    assert first[0] == "✓ backlash_y"
    residual = table(shown, "Effects looked for").columns.index("residual / µm")
    assert 0.0 < float(first[residual]) < 1e6 * found.noise.declared * 1.2
    assert "without any the residual is" in table(shown, "Effects looked for").note


def test_every_coefficient_found_is_explained() -> None:
    _, shown = report("missing_effect")
    assert table(shown, "What was found").rows[0][:3] == ("backlash_y", "b", "half width")


def test_a_similar_effect_that_the_readings_distinguish_is_said_to_be() -> None:
    found, _ = report("missing_effect")
    advice = what_to_measure(found)
    near = replace(advice.separations[0], effects=("backlash_y", "station_drift"), apart_before=21.0)
    words = diagnosis_report(found, replace(advice, separations=(near,)), consequences(found)).words[1]
    assert "similar effect, station_drift" in words
    assert "the readings distinguish them: the patterns differ by 21 standard uncertainties" in words


def test_a_similar_effect_that_is_far_less_probable_may_not_as_well_be_it() -> None:
    """However near their patterns are, the probabilities are those that the table shows."""
    found, _ = report("missing_effect")
    advice = what_to_measure(found)
    near = replace(advice.separations[0], effects=("backlash_y", "station_drift"), apart_before=2.0)
    words = diagnosis_report(found, replace(advice, separations=(near,)), consequences(found)).words[1]
    assert "station_drift, is far less probable in its place" in words
    assert "may as well" not in words and "standard uncertainties" not in words
    rivals = replace(found, search=replace(found.search, sets=((("station_drift",), 0.5), (("backlash_y",), 0.5))))
    assert "may as well be station_drift" in diagnosis_report(rivals, replace(advice, separations=(near,)), {}).words[1]


def test_what_is_part_of_the_map_is_kept_apart_from_what_hides_behind_the_instrument() -> None:
    _, shown = report("adequate")
    held, hidden = table(shown, "Errors that the map holds already"), table(shown, "Effects that would not show here")
    assert "EXX" in held.rows[0][0] and "points" in held.rows[0][1]
    taken = {effects: what for effects, what in hidden.rows}
    assert taken["pointer_zero_offset"].startswith("place of ")
    assert not hidden.note


def test_a_workpiece_is_not_the_map() -> None:
    _, shown = report("outliers")
    hidden = table(shown, "Effects that would not show here")
    assert any("backlash_c" in row[0] and "form of the workpiece" in row[1] for row in hidden.rows)
    assert "make the map wrong" in hidden.note


def test_unexplained_says_on_what_the_residuals_depend() -> None:
    found, shown = report("unexplained")
    assert "No effect is named as the cause" in shown.words[0]
    assert found.search.structure[0].covariate in shown.words[1]
    assert "none of them is named" in table(shown, "Effects looked for").title
    assert table(shown, "What the residuals still depend on").rows


def test_outliers_are_listed_by_row() -> None:
    found, shown = report("outliers")
    assert "do not belong to the rest" in shown.words[0]
    rows = [int(row[0]) for row in table(shown, "Readings that do not belong").rows]
    assert rows == sorted(o.row for o in found.gross_errors)


def test_too_small_a_declared_uncertainty_is_not_blamed_on_an_effect() -> None:
    found, shown = report("too noisy")
    assert found.verdict == "adequate"
    assert "the declared uncertainty is too small" in shown.words[1]


def test_without_repeats_model_and_reproducibility_cannot_be_told() -> None:
    found, _ = report("too noisy")
    noise = replace(found.noise, from_repeats=None)
    bare = replace(found, noise=noise)
    words = diagnosis_report(bare, what_to_measure(bare), {}).words
    assert "model or the reproducibility of the setups is not determined" in words[1]


def test_a_setup_that_is_measured_left_and_measured_again_counts_as_mounted_again() -> None:
    session = simulate(SPECS["adequate"]).session
    assert not mounted_more_than_once(session)
    order = np.argsort(session.readings.repeat, kind="stable")
    assert mounted_more_than_once(session.with_readings(session.readings.select(order)))


def test_all_candidates_on_request() -> None:
    found, _ = report("adequate")
    few = diagnosis_report(found, what_to_measure(found), {}, 3)
    every = diagnosis_report(found, what_to_measure(found), {}, 0)
    assert len(table(few, "Effects looked for").rows) == 3
    assert "left out" in table(few, "Effects looked for").note
    assert len(table(every, "Effects looked for").rows) == sum(1 for r in found.ranked if r.rank)
