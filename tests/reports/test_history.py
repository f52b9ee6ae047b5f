# SPDX-License-Identifier: Apache-2.0
"""The history on disk: comes back as it was, is never half written, and a damaged one is told in one line."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from machine_tool_calibration.diagnosis.history import Coefficient, Entry, History, Part
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.recording.open import open_measurement
from machine_tool_calibration.reports.history import fingerprint, history_path, read_history, update_history

DATA = Path(__file__).parents[1] / "data"


def entry(*effects: str, **changes: object) -> Entry:
    fields: dict[str, object] = {
        "number": 1, "made": "2026-01-01T00:00:00+00:00", "by": "improve", "model": "free", "effects": effects,
        "change": effects[-1] if effects else "", "data": "sha256-0123456789012e45", "used": 288,
        "set_aside": (3, 17), "rms_residual": 1.0 / 3e6, "reduced_chi_square": 16.198280062322, "p_value": 5e-324,
        "degrees_of_freedom": 200, "map_rms": 3.3e-6, "map_uncertainty_rms": 2.2e-7,
        "parameters": (Coefficient(name="a.b", value=0.1 + 0.2, standard_uncertainty=1e-300, unit="1"),),
    }  # fmt: skip
    return Entry.model_validate(fields | changes)


def grown(*effects: str) -> History:
    return History().grown([entry(), entry(*effects)])


def test_it_comes_back_to_the_last_bit(tmp_path: Path) -> None:
    path = tmp_path / "history.yaml"
    for words in ("backlash_y", "no", "1e5", "2026-01-01", "a: b # c", "'\"", "ä µ", "- x", "~", "0x10"):
        wanted = History().grown([entry(), entry("e", change=words, made=words)])
        assert update_history(path, lambda old, wanted=wanted: wanted)[1] == wanted
        assert read_history(path) == wanted
    assert [p.name for p in tmp_path.iterdir()] == ["history.yaml"]
    assert "mtcal history" in path.read_text()


def test_no_file_is_an_empty_history(tmp_path: Path) -> None:
    assert read_history(tmp_path / "history.yaml") == History()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "- 1\n- 2\n",
        "format: mtcal-history/2\nmodels: []\n",
        "format: mtcal-history/1\ncurrent: 4\nmodels: []\n",
        "format: mtcal-history/1\nmodels: [{number: 1}]\n",
        "format: mtcal-history/1\nmodels: []\nmore: 1\n",
        "format: mtcal-history/1\nmodels: [",
        "format: mtcal-history/1\nmodels: !!python/object:os.system x\n",
        "\0",
    ],
)
def test_a_damaged_file_is_one_line_and_is_left_alone(tmp_path: Path, text: str) -> None:
    path = tmp_path / "history.yaml"
    path.write_text(text)
    with pytest.raises(SessionError) as caught:
        update_history(path, lambda old: grown("backlash_y"))
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    assert path.read_text() == text


def test_a_damaged_entry_is_named_by_its_line(tmp_path: Path) -> None:
    path = tmp_path / "history.yaml"
    update_history(path, lambda old: grown("backlash_y"))
    lines = path.read_text().splitlines()
    number = next(k for k, line in enumerate(lines) if "degrees_of_freedom" in line)
    lines[number] = "  degrees_of_freedom: many"
    path.write_text("\n".join(lines))
    with pytest.raises(SessionError, match=rf"line {number + 1}: models\[0\].degrees_of_freedom"):
        read_history(path)


def test_a_crash_in_the_middle_leaves_the_old_history(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "history.yaml"
    _, old = update_history(path, lambda old: grown("backlash_y"))

    def killed(*args: object) -> None:
        raise KeyboardInterrupt

    for step in ("fsync", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(os, step, killed)
            with pytest.raises(KeyboardInterrupt):
                update_history(path, lambda history: history.grown([entry(), entry("dead_path")]))
        assert read_history(path) == old
    _, new = update_history(path, lambda history: history.grown([entry(), entry("dead_path")]))
    assert read_history(path) == new != old


@pytest.mark.long
def test_commands_at_once_lose_nothing(tmp_path: Path) -> None:
    path = tmp_path / "history.yaml"

    def add(k: int) -> None:
        update_history(path, lambda history: history.grown([entry(), entry(f"effect_{k}")]))

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(add, range(24)))
    history = read_history(path)
    assert {e.effects for e in history.models} == {(), *((f"effect_{k}",) for k in range(24))}
    assert sorted(e.number for e in history.models) == list(range(1, 26))


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="cannot be written"):
        update_history(tmp_path / "gone" / "history.yaml", lambda old: grown("backlash_y"))


def test_where_it_is_kept(tmp_path: Path) -> None:
    session = tmp_path / "cube"
    session.mkdir()
    (session / "session.yaml").touch()
    assert history_path(session) == session / "history.yaml"
    assert history_path(session / "session.yaml") == session / "history.yaml"
    bag = tmp_path / "run_1"
    bag.mkdir()
    assert history_path(bag) == tmp_path / "run_1.history.yaml"
    file = tmp_path / "run.mcap"
    file.touch()
    assert history_path(file) == tmp_path / "run.mcap.history.yaml"


def test_the_fingerprint_changes_with_any_reading() -> None:
    session = open_measurement(DATA / "tracking_2d")
    same = open_measurement(DATA / "tracking_2d")
    mark = fingerprint(session)
    assert mark == fingerprint(same)
    readings = session.readings
    moved = readings.displacement.copy()
    moved[7] += 1e-12
    assert fingerprint(session.with_readings(replace(readings, displacement=moved))) != mark
    columns = {**readings.columns, "dir_x": -readings.columns["dir_x"]}
    assert fingerprint(session.with_readings(replace(readings, columns=columns))) != mark


def test_several_sessions_have_a_history_beside_the_first(tmp_path: Path) -> None:
    one, other, far = tmp_path / "days" / "a", tmp_path / "days" / "b", tmp_path / "plate"
    for folder in (one, other, far):
        folder.mkdir(parents=True)
    path = tmp_path / "days" / "a+b.history.yaml"
    assert history_path(one, other) == history_path(other, one) == path
    assert history_path(other, far) == tmp_path / "days" / "b+..-plate.history.yaml"
    many = [tmp_path / f"{k:03d}{'x' * 60}" for k in range(9)]
    assert len(history_path(*many).name) < 255
    assert history_path(*many) != history_path(*many[:-1])


def test_a_history_of_several_sessions_names_them_and_comes_back(tmp_path: Path) -> None:
    parts = [Part(label=name, model="rigid_body", data=f"sha256-{name}", set_aside=(4,)) for name in ("a", "b")]
    history = History().grown([entry(sessions=tuple(parts), set_aside=())])
    path = tmp_path / "a+b.history.yaml"
    assert update_history(path, lambda old: history)[1] == read_history(path) == history
    assert history.models[0].readings_aside == 2
    # The same sessions in another order are the same model.
    again = entry(sessions=tuple(reversed(parts)), set_aside=())
    assert len(history.grown([again]).models) == 1


def test_the_fingerprint_of_several_sessions_does_not_depend_on_their_order() -> None:
    one, other = (open_measurement(DATA / name) for name in ("tracking_2d", "step_diagonal"))
    assert fingerprint(one, other) == fingerprint(other, one)
    assert len({fingerprint(one), fingerprint(other), fingerprint(one, other), fingerprint(one, one)}) == 4
