# SPDX-License-Identifier: Apache-2.0
"""What people read of a diagnosis: the verdict first, and tables that hold what the words say."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from machine_tool_calibration.diagnosis.diagnose import Diagnosis, diagnose
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.planning.dominant import Dominant, Remedy
from machine_tool_calibration.planning.what_to_measure import Advice, what_to_measure
from machine_tool_calibration.reports.diagnosis import Report, diagnosis_report
from machine_tool_calibration.reports.diagnosis_document import diagnosis_document
from machine_tool_calibration.reports.goodness import effect_words
from machine_tool_calibration.reports.identification import result_parts
from machine_tool_calibration.reports.planning import dominant_words
from machine_tool_calibration.reports.quantities import quantity
from machine_tool_calibration.reports.tables import TextTable
from machine_tool_calibration.reports.verdict import verdict_words
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.simulation import PRESETS, DirectPlan, FlawSpec, SimulationSpec, simulate
from machine_tool_calibration.words import say

from ..told import keys
from .measured import SPECS, concluded

DOMINANT = Dominant(
    "angular errors", 4e-7, {"readings": 0.1, "angular errors": 0.84, "time": 0.06}, 5e-6, 1e-9, 3.9e-7,
    (Remedy(kind="diagonal", measure="add the diagonal nnp", uncertainty=2e-7, seconds=360.0,
            aside="mounting the mirror again"),),
)  # fmt: skip


@cache
def report(name: str) -> tuple[Diagnosis, Report]:
    found, then = concluded(name)
    return found, diagnosis_report(found, then.advice, then.changes)


def table(shown: Report, title: str) -> TextTable:
    return next(t for t in (*shown.tables, *shown.details) if t.title == say(f"found.{title}"))


@pytest.mark.parametrize("brief", [True, False])
def test_readings_that_were_set_aside_are_told_whatever_the_verdict(brief: bool) -> None:
    found, then = concluded("outliers")
    for verdict, key in (("outliers", "diagnosis.outliers"), ("adequate", "diagnosis.set_aside_before")):
        words = verdict_words(replace(found, verdict=verdict), then.changes, then.advice, brief=brief)
        assert key in [key for own in words for key in keys(own)]


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "verdict", "says"),
    [
        ("adequate", "adequate", ["diagnosis.nothing_shown"]),
        ("missing_effect", "missing_effect", ["diagnosis.lacks", "diagnosis.formula", "diagnosis.size"]),
        ("unexplained", "unexplained", ["diagnosis.unexplained", "diagnosis.depend"]),
        ("outliers", "outliers", ["diagnosis.outliers"]),
        ("too noisy", "adequate", ["diagnosis.nothing_shown", "diagnosis.no_noise", "diagnosis.repeats_scatter"]),
        ("too little to tell", "adequate", ["fit.differ"]),
    ],
)
def test_words_and_tables_say_what_was_found(name: str, verdict: str, says: list[str]) -> None:
    found, shown = report(name)
    said = [key for words in shown.words for key in keys(words)]
    assert found.verdict == verdict
    assert [key for key in said if key in says] == says
    for each in (*shown.tables, *shown.details):
        assert each.rows
        assert all(len(row) == len(each.columns) for row in each.rows)
        assert not any("nan" in cell.lower().split() for row in each.rows for cell in row)
    assert all("nan" not in words.split() for words in shown.words)


@pytest.mark.long
def test_where_setups_may_differ_as_much_as_an_effect_would_the_likeliest_leads() -> None:
    found, shown = report("too little to tell")
    assert found.accepted == () and found.ranked[0].name == "station_drift"
    (spread,) = (size for size in found.fits[-1].marginal.sizes if size.probability > 0.9)
    assert any(quantity(spread.size, "m") in words for words in shown.words)


def test_an_effect_found_is_told_with_its_size_and_what_it_does() -> None:
    found, shown = report("missing_effect")
    assert shown.words[0] == "The model lacks backlash of Y (backlash_y)."
    assert {"diagnosis.changes", "fit.residual_falls", "diagnosis.with_it_moved"} <= {*keys(shown.words[1])}
    candidates = table(shown, "candidates")
    assert candidates.rows[0][0] == "✓ backlash_y"
    assert 0.0 < float(candidates.rows[0][candidates.columns.index("residual / µm")]) < 1.2e6 * found.noise.declared
    assert "found.note_without" in keys(candidates.note)
    assert table(shown, "coefficients").rows[0][:3] == ("backlash_y", "b", "half width")


def test_how_near_a_similar_effect_is_decides_what_is_said_of_it() -> None:
    """However near their patterns are, the probabilities are those that the table shows."""
    found, then = concluded("missing_effect")
    advice = then.advice
    rivals = replace(found, search=replace(found.search, sets=((("station_drift",), 0.5), (("backlash_y",), 0.5))))
    similar = {"diagnosis.similar", "diagnosis.apart", "diagnosis.as_well"}
    for of, apart, says in ((found, 21.0, similar - {"diagnosis.as_well"}), (found, 2.0, {"diagnosis.similar"}),
                            (rivals, 2.0, {"diagnosis.as_well"})):  # fmt: skip
        near = replace(advice.separations[0], effects=("backlash_y", "station_drift"), apart_before=apart)
        words = diagnosis_report(of, replace(advice, separations=(near,)), {}).words[1]
        assert similar & {*keys(words)} == says and "station_drift" in words


def test_what_is_part_of_the_map_is_kept_apart_from_what_hides_behind_the_instrument() -> None:
    _, shown = report("adequate")
    held, hidden = table(shown, "in_map"), table(shown, "hidden")
    assert "EXX" in held.rows[0][0] and "points" in held.rows[0][1]
    taken = {effects: what for effects, what in hidden.rows}
    assert taken["pointer_zero_offset"].startswith("place of ")
    assert not hidden.note
    # The form of a workpiece is not the map.
    hidden = table(report("outliers")[1], "hidden")
    assert any("backlash_c" in row[0] and "found.form" in keys(row[1]) for row in hidden.rows)
    assert keys(hidden.note) == ["found.wrong_map"]


def test_unexplained_says_on_what_the_residuals_depend() -> None:
    found, shown = report("unexplained")
    assert found.search.structure[0].covariate in shown.words[1]
    assert table(shown, "none_named").rows and table(shown, "structure").rows


def test_outliers_are_listed_by_row() -> None:
    found, shown = report("outliers")
    rows = [int(row[0]) for row in table(shown, "outliers").rows]
    assert rows == sorted(o.row for o in found.gross_errors)


@pytest.mark.long
def test_without_repeats_model_and_reproducibility_cannot_be_told() -> None:
    found, _ = report("too noisy")
    bare = replace(found, noise=replace(found.noise, from_repeats=None))
    assert "diagnosis.mounted_once" in keys(diagnosis_report(bare, what_to_measure(bare), {}).words[1])


def test_a_setup_that_is_measured_left_and_measured_again_counts_as_mounted_again() -> None:
    session = simulate(SPECS["adequate"]).session
    assert not session.mounted_again
    order = np.argsort(session.readings.repeat, kind="stable")
    assert session.with_readings(session.readings.select(order)).mounted_again


def test_all_candidates_on_request() -> None:
    found, then = concluded("adequate")
    few, every = (table(diagnosis_report(found, then.advice, {}, k), "candidates") for k in (3, 0))
    assert len(few.rows) == 3 and "found.note_left" in keys(few.note)
    assert len(every.rows) == sum(1 for r in found.ranked if r.rank)


@pytest.mark.parametrize(
    ("cause", "says"),
    [
        ("angular errors", ["found.dominant", "found.remedy_again", "found.remedy_besides"]),
        ("time", ["found.dominant_time", "found.no_remedy"]),
        ("readings", ["found.dominant_readings"]),
    ],
)
def test_what_dominates_is_told_with_its_remedy(cause: str, says: list[str]) -> None:
    own = DOMINANT if cause == DOMINANT.cause else replace(DOMINANT, cause=cause, remedies=())  # type: ignore[arg-type]
    told = list(dominant_words(own))
    assert [key for words in told for key in keys(words)] == says
    if cause == DOMINANT.cause:
        assert "84 %" in told[0] and "5.00 µrad" in told[0]
        assert told[1].strip() == (
            "add the diagonal nnp (6 min, and mounting the mirror again) leaves 50 % of U, the same once more 98 %"
        )


def test_a_diagnosis_says_what_dominates_where_it_is_not_the_scatter() -> None:
    found, _ = report("adequate")
    assert any(
        "add the diagonal nnp" in words for words in diagnosis_report(found, Advice(dominant=DOMINANT), {}).forecast
    )
    document = diagnosis_document(found, Advice(dominant=DOMINANT), {})
    assert document["dominant"]["cause"] == "angular errors"
    assert document["dominant"]["measure"][0]["uncertainty"] == 2e-7
    assert diagnosis_document(found, Advice(), {})["dominant"] is None


def exchanged(plan: str, axis: str) -> Session:
    """A session of a machine with backlash, its directions of approach recorded the wrong way round."""
    effects = (FlawSpec(id=f"backlash_{axis}", size=2e-6),)
    session = simulate(SimulationSpec(plan=PRESETS[plan], seed=77, effects=effects)).session
    columns = {**session.readings.columns, f"dir_{axis}": -session.readings.columns[f"dir_{axis}"]}
    return session.with_readings(replace(session.readings, columns=columns))


@pytest.mark.long
def test_a_coefficient_that_is_negative_and_should_not_be_is_said_to_be() -> None:
    session = exchanged("tracking_2d", "y")
    negative = say("fit.negative_backlash", name="backlash_y")
    # That of X is nothing, whatever its sign.
    result = identify(session, effects=("backlash_x", "backlash_y"))
    assert list(effect_words(result.joint, result.effects)) == [negative]
    assert negative in list(result_parts(result.document(), [session], result))
    run = identify(exchanged("iso230_2", "x"), effects=("lost_motion_x",), keep_all=True)
    assert say("fit.negative_backlash", name="lost_motion_x") in list(effect_words(run.joint, run.effects))
    found, _ = report("missing_effect")
    positive = identify(found.chosen.sessions[0], effects=("backlash_y",))
    assert not list(effect_words(positive.joint, positive.effects))
    turned = diagnose(exchanged("iso230_2", "x"))
    negative = say("fit.negative_backlash", name="backlash_x")
    assert turned.accepted == ("backlash_x",) and list(verdict_words(turned, {}, Advice())).count(negative) == 1


def test_lost_motion_is_negative_where_it_was_read() -> None:
    """Where the constant is negative only because the rest of the travel was not read, nothing is overcompensated.

    Nor where it has either sign where it was read.
    """
    session = simulate(SimulationSpec(plan=PRESETS["iso230_2"], seed=77)).session
    travel = {"x": (-0.8, 0.4)}
    machine = session.description.machine.model_copy(update={"travel": travel})
    session = replace(session, description=session.description.model_copy(update={"machine": machine}))
    x, sense = session.readings.column("x"), session.readings.column("dir_x")
    for sign, least in ((1.0, 1e-6), (-1.0, 1e-6), (-1.0, -4e-6)):
        half = sign * (40e-6 * x + least)
        moved = replace(session.readings, displacement=session.readings.displacement - half * sense)
        run = identify(session.with_readings(moved), effects=("lost_motion_x",), keep_all=True)
        constant = next(p.value for p in run.parameters if p.name == "lost_motion_x.b0")
        assert constant * sign < -2e-6 and float(np.mean(half)) * sign > 0.0
        negative = [say("fit.negative_backlash", name="lost_motion_x")] if sign < 0 < least else []
        assert list(effect_words(run.joint, run.effects)) == negative


def test_a_lead_on_a_grid_of_places_may_be_a_shorter_one() -> None:
    """Read every 2.5 mm, once in 2 mm looks like once in 10 mm, and in 3.33 mm; where places are uneven it does not."""
    for x, others in ((np.arange(0.0, 1.0, 2.5e-3), "3.33 mm and 2 mm"), (np.linspace(0.0, 1.0, 401) ** 1.1, "")):
        plan = DirectPlan(kind="points", points=tuple((float(p), 0.0, 0.0) for p in x), terms=("EXX",))
        session = simulate(SimulationSpec(plan=plan, seed=1)).session
        wave = 20.0 * session.sigma * np.sin(2.0 * np.pi * session.readings.column("x") / (2e-3 if others else 10e-3))
        moved = replace(session.readings, displacement=session.readings.displacement + wave)
        run = identify(session.with_readings(moved), effects=("pitch_periodic_x",), keep_all=True)
        lead = next(p.value for p in run.parameters if p.name == "pitch_periodic_x.lead")
        assert lead == pytest.approx(10e-3, rel=0.02)
        said = " ".join(effect_words(run.joint, run.effects))
        assert ("pitch_periodic_x.lead looks like" in said) == bool(others) and others in said


@pytest.mark.long
def test_what_is_likely_is_said_beside_readings_that_were_set_aside() -> None:
    """Of an axis that was run both ways besides that directions differ, and no places."""
    named = diagnose(exchanged("iso230_2", "x"))
    unsure = replace(named, verdict="outliers", accepted=(), fitted=named.fitted[:1])
    told = {key for words in verdict_words(unsure, {}, Advice()) for key in keys(words)}
    assert {"diagnosis.none_sure", "diagnosis.likely", "fit.reversal"} <= told
    assert not {"diagnosis.nothing_shown", "diagnosis.places_differ"} & told


def test_where_nothing_is_named_it_is_told_what_the_likely_one_that_explains_most_leaves() -> None:
    """A reversal of 1.5 µm that was not accepted: beside it there is the readings' noise of 0.3 µm alone."""
    found, _ = report("missing_effect")
    unsure = replace(found, verdict="unexplained", accepted=(), fitted=found.fitted[:1])
    first, known = unsure.fits[0], unsure.search.of("backlash_y")
    whole = float(np.sqrt(np.mean(np.concatenate([one.residuals for one in first.fits]) ** 2)))
    free = first.solution.degrees_of_freedom - 1
    assert known.rms_after == pytest.approx(3e-7 * np.sqrt(free / len(found.chosen.sessions[0].readings)), rel=0.1)

    def told(*left: float) -> list[str]:
        """What is said where so much is left beside the likely ones, the likeliest first."""
        others = [one for one in unsure.search.findings if one is not known]
        likely = [
            replace(one, probability=0.9 - 0.1 * k, rms_after=rest)
            for k, (one, rest) in enumerate(zip([known, *others], left, strict=False))
        ]
        unlikely = [replace(one, probability=0.01) for one in others[len(left) - 1 :]]
        search = replace(unsure.search, findings=(*likely, *unlikely))
        return [str(words) for words in verdict_words(replace(unsure, search=search), {}, Advice())]

    def leaves(name: str, left: float) -> str:
        return str(say("diagnosis.most_is_of", name=name, left=quantity(left, "m")))

    none = str(say("diagnosis.none_accounts"))
    assert any(text.endswith(leaves("backlash_y", known.rms_after)) for text in told(known.rms_after))
    # From half of the squares on.
    most, more = (np.sqrt(share) * whole for share in (0.49, 0.51))
    assert any(text.endswith(leaves("backlash_y", most)) for text in told(most))
    assert any(text.endswith(none) for text in told(more))
    # The one that leaves least, which need not be the likeliest.
    other = next(one.name for one in unsure.search.findings if one is not known)
    assert any(text.endswith(leaves(other, 0.3 * whole)) for text in told(0.5 * whole, 0.3 * whole))
    assert any(text.endswith(leaves("backlash_y", 0.3 * whole)) for text in told(0.3 * whole, more))


@pytest.mark.parametrize("verdict", ["adequate", "outliers"])
def test_structure_that_is_too_small_to_matter_is_said_to_be(monkeypatch: pytest.MonkeyPatch, verdict: str) -> None:
    sound, _ = report("adequate")
    assert not any("diagnosis.structure_unsure" in keys(words) for words in verdict_words(sound, {}, Advice()))
    monkeypatch.setattr(Diagnosis, "left", (SimpleNamespace(share=0.2),))
    small = replace(sound, verdict=verdict, search=replace(sound.search, unknown=0.97, nothing=0.01))
    told = [key for words in verdict_words(small, {}, Advice()) for key in keys(words)]
    assert {"diagnosis.nothing_matters", "diagnosis.good_enough"} <= {*told}
