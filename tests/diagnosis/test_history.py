# SPDX-License-Identifier: Apache-2.0
import pytest
from pydantic import ValidationError

from machine_tool_calibration.diagnosis.history import Entry, History, Part
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.methods.fitted import joint_models
from machine_tool_calibration.simulation import SimulationSpec, simulate
from machine_tool_calibration.words import words


def entry(*effects: str, rms: float = 1e-6, data: str = "sha256-1", **changes: object) -> Entry:
    fields: dict[str, object] = {
        "number": 1, "made": "2026-01-01T00:00:00+00:00", "by": "improve", "model": "free", "effects": effects,
        "change": effects[-1] if effects else "", "data": data, "used": 288, "rms_residual": rms,
        "degrees_of_freedom": 200,
    }  # fmt: skip
    return Entry.model_validate(fields | changes)


def test_models_are_numbered_and_know_where_they_come_from() -> None:
    history = History().grown([entry(), entry("backlash_y"), entry("backlash_y", "dead_path")])
    assert [(e.number, e.parent) for e in history.models] == [(1, None), (2, 1), (3, 2)]
    assert history.current == 3
    assert history.in_use is not None
    assert history.in_use.effects == ("backlash_y", "dead_path")


def test_undo_goes_back_to_where_the_model_came_from_and_keeps_it() -> None:
    history = History().grown([entry(), entry("backlash_y")]).grown([entry(), entry("dead_path")])
    assert [(e.number, e.parent) for e in history.models] == [(1, None), (2, 1), (3, 1)]
    undone = history.undone()
    assert undone.current == 1
    assert undone.models == history.models
    with pytest.raises(ModelError, match="made from no other"):
        undone.undone()
    assert undone.using(2).current == 2
    with pytest.raises(ModelError, match="no model 7; it has 1, 2, 3"):
        undone.using(7)
    with pytest.raises(ModelError, match="empty"):
        History().undone()


def test_the_same_model_is_not_kept_twice_but_another_outcome_is() -> None:
    once = History().grown([entry(), entry("backlash_y")])
    twice = once.undone().grown([entry(), entry("backlash_y", made="2027-01-01T00:00:00+00:00")])
    assert twice == once
    assert len(once.grown([entry(rms=2e-6)]).models) == 3
    assert len(once.grown([entry(data="sha256-2")]).models) == 3
    assert len(once.grown([entry(set_aside=(4, 5))]).models) == 3
    assert len(once.grown([]).models) == 2


def test_what_changed_is_said_in_the_language_of_the_reader() -> None:
    """By keys, not in the words of the command that made it."""
    first, aside = entry(change="as recorded"), entry(change="2 readings set aside", set_aside=(4, 5))
    added = entry("backlash_y", set_aside=(4, 5))
    spread = entry("backlash_y", set_aside=(4, 5), change="+ in U", alternatives={"": {"dead_path": 0.4}})
    told = [one.changed(before) for one, before in ((aside, None), (aside, first), (added, aside), (spread, added))]
    german = [words("de").told(one) for one in told]
    assert german == ["2 Ablesungen beiseitegelegt"] * 2 + ["backlash_y", "+ in U, was es geben kann"]
    assert first.changed(None) == "as recorded"


@pytest.mark.parametrize(
    ("alternatives", "why"),
    [
        ({"linear_drift": {"linear_drift": 0.3}}, "of an effect in the model others may be true"),
        ({"dead_path": {"warmup_x": 0.3}}, "of an effect in the model others may be true"),
        ({"linear_drift": {"warmup_x": 0.9, "dead_path": 0.9}}, "sum to more than 1"),
        ({"linear_drift": {"warmup_x": -0.1}}, "greater than 0"),
    ],
)
def test_what_an_effect_may_be_instead_is_checked(alternatives: dict[str, dict[str, float]], why: str) -> None:
    with pytest.raises(ValidationError, match=why):
        entry("linear_drift", alternatives=alternatives)


def test_rows_that_the_readings_have_not_are_refused() -> None:
    plan = {"method": "direct", "kind": "iso230_2", "axis": "x", "repeats": 3, "count": 6, "chain": "w-X-Y-b-Z-t"}
    session = simulate(SimulationSpec.model_validate({"seed": 1, "plan": plan})).session
    known = entry(data="own", model="tables", set_aside=(3,))
    assert 3 not in known.request([session], ["A"], ["own"]).sessions[0].readings.row
    for rows in ({"set_aside": (3, 999)}, {"kept": (999,)}):
        with pytest.raises(ModelError, match="model 1 of the history names row 999"):
            known.model_copy(update=rows).request([session], ["A"], ["own"])
        # Of other readings, some may be new or gone.
        assert known.model_copy(update=rows).request([session], ["A"], ["others"])


def test_a_history_that_contradicts_itself_is_refused() -> None:
    for models, current in (([entry(), entry()], 1), ([entry()], 3), ([entry(parent=9)], 1), ([entry(parent=1)], 1)):
        with pytest.raises(ValidationError):
            History(models=tuple(models), current=current)
    with pytest.raises(ValidationError, match="used"):
        Entry.model_validate({**entry().model_dump(), "used": 0})


@pytest.mark.parametrize("variant", ["free", "rigid_body"])
@pytest.mark.parametrize("step", [1, -1])
def test_every_session_keeps_the_variant_that_it_was_fitted_with(variant: str, step: int) -> None:
    """One that was asked for, where a session's method has it; otherwise what it shares. A further session has any."""
    machine = {"seed": 5, "chain": "w-X-Y-b-Z-t", "travel": {axis: (0.0, 0.4) for axis in "XYZ"}}
    plans = (
        {"method": "tracking_interferometer", "dimension": 2, "chain": "w-X-Y-b-Z-t"},
        {"method": "direct", "kind": "iso230_2", "axis": "x", "repeats": 3, "count": 6, "chain": "w-X-Y-b-Z-t"},
    )
    run_of = [{"seed": 1, "plan": plan, "machine": machine} for plan in plans]
    sessions = [simulate(SimulationSpec.model_validate(spec)).session for spec in run_of][::step]
    names, labels = (variant, "rigid_body")[::step], ["tracker", "run"][::step]
    parts = [Part(label=label, model=name, data=label) for label, name in zip(labels, names, strict=True)]
    request = entry(model="joint", sessions=tuple(parts)).request(sessions, labels, labels)
    assert request.model == (None if variant == "rigid_body" else "free")
    assert joint_models(request)[1] == names
    # A session that the model does not know asks for nothing.
    alone = entry(model="joint", sessions=(parts[0],)).request(sessions, labels, labels)
    assert alone.model == (names[0] if names[0] == "free" else None)
