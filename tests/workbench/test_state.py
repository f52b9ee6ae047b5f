# SPDX-License-Identifier: Apache-2.0
"""One window's work: models that are added, taken away and undone, and kept with the session.
What the pages show of a diagnosis and of an effect of the user's own.
"""

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.effects.formula import FormulaEffect
from machine_tool_calibration.errors import CalibrationError, ModelError
from machine_tool_calibration.interface.session import simulate
from machine_tool_calibration.reports.history import history_path, read_history
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.workbench.models import Model
from machine_tool_calibration.workbench.readings import Readings
from machine_tool_calibration.workbench.state import State, measurements_in


def opened(*paths: Path) -> State:
    state = State()
    state.opened(*paths)()
    return state


@pytest.fixture
def struck(tmp_path: Path) -> Path:
    """A session with three gross errors."""
    folder = tmp_path / "struck"
    session = simulate("tracking_2d", seed=3).sessions[0]
    wrong = session.readings.displacement.copy()
    wrong[[20, 90, 150]] += 80e-6
    write_session(session.with_readings(replace(session.readings, displacement=wrong)), folder)
    return folder


def test_an_effect_is_added_and_undone_and_the_history_holds_it(hidden: Path) -> None:
    state = opened(hidden)
    first = state.model.fit.rms_residual
    assert not history_path(hidden).exists(), "to look at a session leaves nothing in it"
    state.changed(add="backlash_y")()
    assert state.model.fit.effects == ("backlash_y",)
    assert state.model.fit.rms_residual < 0.5 * first
    kept = read_history(history_path(hidden))
    assert kept.in_use is not None and kept.in_use.effects == ("backlash_y",) and kept.in_use.by == "workbench"
    assert "saved as model 2" in state.headline and not state.warning
    state.undo()
    assert state.model.fit.rms_residual == first
    assert "saved as model 1" in state.headline and state.warning.startswith("Model 2 (backlash_y) fits better")
    assert read_history(history_path(hidden)).current == 1
    state.undo()
    assert "nothing to undo" in state.remark and len(state.models) == 1


@pytest.mark.long
def test_what_was_added_and_taken_away_again_is_the_first_model_of_the_history(hidden: Path) -> None:
    state = opened(hidden)
    state.changed(add="backlash_y")()
    state.changed(take="backlash_y")()
    assert [model.number for model in state.models] == [1, 2, 1]
    assert read_history(history_path(hidden)).current == 1


@pytest.mark.long
def test_a_window_opened_later_goes_on_where_the_history_is(hidden: Path) -> None:
    state = opened(hidden)
    state.changed(aside=[5, 6])()
    state.changed(add="backlash_y")()
    again = opened(hidden)
    assert again.model.fit.effects == ("backlash_y",) and again.model.aside == {5, 6}
    assert [model.number for model in again.models] == [1, 2, 3]
    np.testing.assert_array_equal(again.model.comparison.fit.residuals, state.model.comparison.fit.residuals)


@pytest.mark.long
def test_two_windows_do_not_disturb_each_other(hidden: Path) -> None:
    one, two = opened(hidden), opened(hidden)
    one.changed(add="backlash_y")()
    assert two.model.fit.effects == ()
    two.changed(add="backlash_x")()
    assert one.model.fit.effects == ("backlash_y",) and two.model.fit.effects == ("backlash_x",)
    kept = {entry.effects for entry in read_history(history_path(hidden)).models}
    assert kept == {(), ("backlash_y",), ("backlash_x",)}
    two.undo()
    assert one.model.fit.effects == ("backlash_y",)


def test_a_history_that_cannot_be_written_leaves_the_window_working(hidden: Path) -> None:
    history_path(hidden).write_text("- damaged\n", encoding="utf-8")
    state = opened(hidden)
    assert "is no history of models" in state.remark
    state.changed(add="backlash_y")()
    assert state.model.fit.effects == ("backlash_y",) and "in this window only" in state.remark
    assert history_path(hidden).read_text(encoding="utf-8") == "- damaged\n"


@pytest.mark.long
def test_a_history_that_was_moved_away_is_begun_anew(hidden: Path) -> None:
    state = opened(hidden)
    for name in ("backlash_x", "backlash_y", "warmup_y"):
        state.changed(add=name)()
    history_path(hidden).unlink()
    state.undo()
    kept = read_history(history_path(hidden))
    assert [entry.effects for entry in kept.models] == [(), ("backlash_x",), ("backlash_x", "backlash_y")]
    assert kept.current == 3 == state.model.number and state.model.fit.effects == ("backlash_x", "backlash_y")
    going = state.used(1)
    history_path(hidden).unlink()
    with pytest.raises(ModelError, match="the history has no model 1"):
        going()
    assert state.model.number == 3, "what cannot be kept is not in use"


def test_an_unknown_effect_changes_nothing(hidden: Path) -> None:
    state = opened(hidden)
    with pytest.raises(ModelError, match="backlash_q"):
        state.changed(add="backlash_q")()
    assert len(state.models) == 1


@pytest.mark.long
def test_readings_set_aside_stay_in_the_source_and_come_back(hidden: Path) -> None:
    state = opened(hidden)
    readings = Readings(state)
    state.tell = readings.refresh
    readings.refresh()
    before = np.array(readings.data["residual"])
    readings.select([5, 6])
    state.changed(aside=readings.selected)()
    residual, aside = (np.array(readings.data[name]) for name in ("residual", "aside"))
    assert np.flatnonzero(np.isnan(residual)).tolist() == [5, 6] == np.flatnonzero(np.isfinite(aside)).tolist()
    np.testing.assert_array_equal(aside[[5, 6]], before[[5, 6]])
    assert readings.selected == [5, 6], "a selection outlives another model"
    state.changed(aside=[])()
    np.testing.assert_allclose(readings.data["residual"], before, atol=1e-9)


@pytest.mark.long
def test_readings_are_selected_by_their_rows(hidden: Path, struck: Path) -> None:
    readings = Readings(opened(hidden))
    readings.refresh()
    readings.select_rows("7, 20-22,280-999")
    assert readings.selected == [7, 20, 21, 22, *range(280, 288)]
    for wrong in ("288", "a", "5-", "7,", "cube:7", "-1"):
        with pytest.raises(CalibrationError, match=r"say rows as 264, 470-476$"):
            readings.select_rows(wrong)
    assert len(readings.selected) == 12, "as it was"
    readings = Readings(opened(hidden, struck))
    readings.refresh()
    readings.select_rows("cube:5, struck:0-1")
    assert readings.selected == [5, 288, 289]
    with pytest.raises(CalibrationError, match=r"or cube:264$"):
        readings.select_rows("7")


def test_arrows_point_along_what_is_sensed(hidden: Path) -> None:
    state = opened(hidden)
    readings = Readings(state)
    readings.refresh()
    data = readings.data
    ends = {"xy:u": "x", "xy:v": "y"}
    drawn = np.column_stack([np.array(data[end]) - np.array(data[axis]) for end, axis in ends.items()])
    sensed = state.model.each[0].fit.model.observations.direction[:, :2]
    residual = np.array(data["residual"])
    np.testing.assert_allclose(drawn, 1e-3 * readings.magnification * residual[:, None] * sensed, atol=1e-9)
    bulk = 1e-3 * readings.magnification * np.quantile(np.abs(residual), 0.98)
    assert 0.4 * 0.12 * 400.0 < bulk <= 0.12 * 400.0, "mm: they are seen, and hide nothing"
    assert readings.magnification in {m * 10.0**k for m in (1, 2, 5) for k in range(8)}, "it can be told"
    assert set(np.array(data["arrow"])[residual > 0]) == {0xD55E00FF}


def test_arrows_of_sessions_along_different_lines_stand_up_from_each(tmp_path: Path) -> None:
    for seed, axis in enumerate("xyz"):
        simulate("iso230_2", seed=seed, axis=axis).save(tmp_path / axis)
    readings = Readings(opened(*(tmp_path / axis for axis in "xyz")))
    readings.refresh()
    assert readings.arrows == "Residuals along x, y, z, standing up from the lines"
    data, larger = readings.data, 1e-3 * readings.magnification * np.array(readings.data["residual"])
    for axis, view, along, up in (("x", "xy", "u", "v"), ("y", "xy", "v", "u"), ("z", "xz", "v", "u")):
        mine = np.array([name.startswith(f"{axis}:") for name in data["row"]])
        across = view.replace(axis, "")
        np.testing.assert_array_equal(data[f"{view}:{along}"][mine], data[axis][mine])
        standing = data[f"{view}:{up}"][mine] - data[across][mine]
        np.testing.assert_allclose(standing, larger[mine], atol=1e-9)
        assert np.ptp(standing) > 1.0, "mm: they are seen"
        (end_on,) = {"xy", "xz", "yz"} - {view for view in readings.planes if axis in view}
        for end, name in zip("uv", end_on, strict=True):
            np.testing.assert_array_equal(data[f"{end_on}:{end}"][mine], data[name][mine])


def test_measurements_are_found_in_a_folder(hidden: Path) -> None:
    assert measurements_in(hidden) == [hidden]
    assert measurements_in(hidden.parent) == [hidden]
    assert measurements_in(hidden / "nothing") == []


@pytest.mark.long
def test_what_a_search_set_aside_is_shown_and_put_back_for_good(struck: Path) -> None:
    state = opened(struck)
    assert state.model.aside == {20, 90, 150} == state.model.found.keys() and "3 readings set aside" in state.headline
    assert not state.models[0].aside, "the first model has all readings, and can be gone back to"
    np.testing.assert_allclose(list(state.model.found.values()), 80e-6, atol=10e-6)
    state.changed(aside=[20, 150])()
    assert state.model.aside == {20, 150} and state.model.kept == {90}
    assert read_history(history_path(struck)).models[-1].kept == (90,)
    assert state.model.fit.measurement.sessions[0].sound == {90}, "no search sets it aside again"
    assert opened(struck).model.kept == {90}
    state.changed(aside=[20, 90, 150])()
    assert state.model.kept == frozenset()


@pytest.mark.long
def test_what_does_not_belong_to_the_rest_is_judged_beside_the_effects(hidden: Path) -> None:
    """As `mtcal identify` does: a reading that only the lack of an effect made stand out is put back."""
    state = opened(hidden)
    first = state.model
    away = frozenset([5, 7])  # 7 by the user
    state.use(state.subject.tried(first, "aside", first.fit.chosen, away, frozenset(), {5: 1e-6}))
    looked: list[Model] = []
    state.tried("backlash_y", looked.append)()
    assert looked[0].aside == {7} and looked[0].found == {}
    state.diagnosed()()
    assert state.lacking and state.diagnosis is not None
    assert 5 in state.diagnosis.chosen.sessions[0].readings.row
    state.improved()()
    assert state.model.aside == {7} and state.model.fit.effects == ("backlash_y",) and not state.lacking
    state.undo()
    assert state.model.aside == {5, 7} and state.model.by_user == {7}
    assert "(backlash_y) fits better" in state.warning, "though it is of one reading more"
    state.changed(add="backlash_y")()
    assert state.model.aside == {7}


@pytest.mark.long
def test_an_effect_of_the_users_own_comes_back_with_the_history(hidden: Path) -> None:
    state = opened(hidden)
    unknown = {"b": {"unit": "m", "low": -1, "high": 1}}
    state.know(FormulaEffect({"id": "mine", "enters": "y", "formula": "b * dir_y", "coefficients": unknown}))
    state.changed(add="mine")()
    found = state.model.fit.rms_residual
    state.undo()
    again = opened(hidden)
    again.used(2)()
    assert again.model.fit.effects == ("mine",) and again.model.fit.rms_residual == found
    assert len(read_history(history_path(hidden)).models) == 2, "the same formula is the same model"


@pytest.mark.long
def test_several_sessions_are_fitted_together(struck: Path, hidden: Path) -> None:
    state = opened(hidden, struck)
    pickle.dumps(state.model)  # it goes from process to process
    count = len(state.sessions[0].readings)
    assert state.model.aside == {count + 20, count + 90, count + 150}
    names = [state.subject.name(number) for number in sorted(state.model.aside)]
    assert names == ["struck:20", "struck:90", "struck:150"]
    readings = Readings(state)
    state.tell = readings.refresh
    readings.refresh()
    data = readings.data
    assert len(data["row"]) == 2 * count and data["row"][count] == "struck:0"
    assert np.flatnonzero(np.isfinite(np.array(data["aside"]))).tolist() == sorted(state.model.aside)
    for found, part in zip(state.model.each, (slice(0, count), slice(count, None)), strict=True):
        held = np.array(data["residual"][part])
        np.testing.assert_allclose(held[np.isfinite(held)], 1e6 * found.fit.residuals)
    state.changed(add="backlash_y", aside=state.model.aside - {count + 90})()
    kept = read_history(history_path(hidden, struck))
    assert kept.in_use is not None
    assert [(part.label, part.set_aside, part.kept) for part in kept.in_use.sessions] == [
        ("cube", (), ()), ("struck", (20, 150), (90,)),
    ]  # fmt: skip
    again = opened(hidden, struck)
    assert again.model.aside == state.model.aside and again.model.number == state.model.number == 3
    np.testing.assert_array_equal(again.model.each[1].fit.residuals, state.model.each[1].fit.residuals)


@pytest.mark.long
def test_what_the_diagnosis_names_is_added_as_improve_does(state: State) -> None:
    with pytest.raises(CalibrationError, match="no diagnosis"):
        state.improved()
    told: list[float] = []
    # As it goes to another process and comes back.
    job = pickle.loads(pickle.dumps(state.diagnosed().work))
    state.diagnosed().take(pickle.loads(pickle.dumps(job(lambda what, share: told.append(share)))))
    assert state.diagnosis is not None and state.diagnosis.accepted == ("backlash_y",)
    assert told == sorted(told) and told[-1] <= 1.0
    first = state.model.fit.rms_residual
    state.improved()()
    assert state.model.fit.effects == ("backlash_y",) and state.model.fit.rms_residual < 0.5 * first
    assert state.diagnosis is None, "that of the model before is not this one's"


def test_the_pattern_of_an_effect_of_the_users_own_is_that_of_the_same_effect_of_the_catalogue(state: State) -> None:
    from machine_tool_calibration.workbench.own_effect import unknowns_of

    coefficients = {"coefficients": unknowns_of("b m -2e-5 2e-5")}
    state.know(FormulaEffect({"id": "mine", "enters": "y", "formula": "b * dir_y", **coefficients}))
    looked: list[Model] = []
    for name in ("mine", "backlash_y"):
        state.tried(name, looked.append)()
    ours, theirs = looked
    assert len(state.models) == 1, "to look at an effect puts it into no model"
    np.testing.assert_allclose(ours.comparison.fit.residuals, theirs.comparison.fit.residuals, atol=1e-12)
    assert np.ptp(state.model.comparison.fit.residuals - ours.comparison.fit.residuals) > 2e-6


def test_unknowns_are_read_from_a_line() -> None:
    from machine_tool_calibration.workbench.own_effect import unknowns_of

    assert unknowns_of("b m -2e-5 2e-5, q 1/K -1 1") == {
        "b": {"unit": "m", "low": -2e-5, "high": 2e-5},
        "q": {"unit": "1/K", "low": -1.0, "high": 1.0},
    }
    assert unknowns_of(" ") == {}
    with pytest.raises(ModelError, match="'b m 1': name, unit"):
        unknowns_of("b m 1")


def test_a_map_is_drawn_with_its_expanded_uncertainty(state: State) -> None:
    from machine_tool_calibration.workbench.look import map_arrows

    found = state.model.fit.result.error_map
    drawn = map_arrows(found, 1000.0)
    np.testing.assert_allclose(drawn["x1"] - drawn["x"], 1e3 * 1000.0 * found.error[:, 0])
    np.testing.assert_allclose(drawn["wy"], 1e3 * 1000.0 * 2 * 2 * found.uncertainty[:, 1])
    assert np.isnan(drawn["ez"]).all() and (drawn["wz"] == 0.0).all(), "not determined: said so, and not drawn"
