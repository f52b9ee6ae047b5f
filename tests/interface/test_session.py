# SPDX-License-Identifier: Apache-2.0
"""Loading and simulating, effects of the user's own, what results look like, and what goes wrong."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import machine_tool_calibration as mtcal
from machine_tool_calibration.errors import ModelError, SessionError


@pytest.fixture(scope="module")
def session() -> mtcal.Measurement:
    return mtcal.simulate("iso230_2", effects={"backlash_x": 1.5e-6}, repeats=2, seed=3)


@pytest.fixture(scope="module")
def fit(session: mtcal.Measurement) -> mtcal.Fit:
    return mtcal.identify(session)


def test_a_session_comes_back_from_its_folder(session: mtcal.Measurement, tmp_path: Path) -> None:
    session.save(tmp_path / "run")
    again = mtcal.load(str(tmp_path / "run"))
    pd.testing.assert_frame_equal(again.readings, session.readings)
    assert again.truth is None
    assert session.truth is not None
    assert session.truth["effects"][0]["id"] == "backlash_x"
    with pytest.raises(SessionError, match="holds a session already"):
        session.save(tmp_path / "run")
    other = mtcal.simulate("iso230_2", repeats=2, seed=4)
    assert mtcal.load(other, tmp_path / "run").labels == ("iso230_2", "run")
    assert mtcal.load(session, other).labels == ("iso230_2#1", "iso230_2#2")


def test_simulate_takes_what_the_command_takes() -> None:
    sized = mtcal.simulate("tracking_2d", effects={"warmup_x": {"size": 4e-6, "tau": 900.0}}, repeats=1, seed=1)
    assert sized.truth is not None
    (effect,) = sized.truth["effects"]
    assert (effect["size"], effect["tau"]) == (4e-6, 900.0)
    lost = mtcal.simulate("iso230_2", missing=0.3, seed=1).readings["displacement"]
    assert 0 < lost.isna().mean() < 0.6
    quiet = mtcal.simulate("direct", noise_factor=0.0, seed=1)
    assert mtcal.identify(quiet).rms_residual < 0.1 * quiet.sessions[0].sigma


def test_repr_is_one_line_and_html_is_escaped(session: mtcal.Measurement, fit: mtcal.Fit, tmp_path: Path) -> None:
    session.save(tmp_path / "a<b>&c")
    loaded = mtcal.load(tmp_path / "a<b>&c")
    for shown in (loaded, fit, fit.compare()):
        assert "\n" not in repr(shown)
        assert repr(shown).startswith(f"<{type(shown).__name__}: ")
        html = shown._repr_html_()
        assert html.startswith("<p><b>") and html.endswith("</pre>")
    html = loaded._repr_html_()
    assert "a&lt;b&gt;&amp;c" in html
    assert "a<b>" not in html
    assert repr(mtcal.load(mtcal.simulate("iso230_2", seed=4), loaded)).count("iso230_2: direct") == 1


def test_a_picture_shows_itself_in_a_notebook(fit: mtcal.Fit) -> None:
    figure = fit.plot("residuals")
    assert figure._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]


def test_what_is_not_determined_is_flagged(fit: mtcal.Fit) -> None:
    assert not fit.error_map["determined_y"].any()
    assert fit.error_map[["ey", "uy"]].isna().all(axis=None)
    assert fit.error_map["determined_x"].all()
    error, u = fit.error_at(fit.error_map.loc[:2, ["x", "y", "z"]])
    np.testing.assert_array_equal(error[:, 0], fit.error_map.loc[:2, "ex"])
    np.testing.assert_array_equal(np.isnan(u), [[False, True, True]] * 3)
    assert np.isnan(fit.error_at([9.0, 0.0, 0.0])[0]).all()


def test_runs_along_two_axes_are_known_along_themselves(tmp_path: Path) -> None:
    (tmp_path / "session.yaml").write_text(
        "format: mtcal-session/1\nmethod: direct\nmachine: {chain: w-Y-X-b-t}\ndatum: none\nterms: [EXX, EYY]\n"
        "standard_uncertainty: {displacement: 1e-6}\nsetups: [{id: X}, {id: Y}]\n"
    )
    rows = [f"X,{0.1 * k},0,1,0,0,{k % 5}e-6" for k in (0, 1, 2, 3, 3, 2, 1, 0)]
    rows += [f"Y,0,{0.1 * k},0,1,0,{k % 5}e-6" for k in (0, 1, 2, 3, 3, 2, 1, 0)]
    (tmp_path / "observations.csv").write_text("setup,x,y,gx,gy,gz,displacement\n" + "\n".join(rows) + "\n")
    error, u = mtcal.identify(mtcal.load(tmp_path)).error_at([[0.15, 0.0, 0.0], [0.0, 0.15, 0.0], [0.1, 0.1, 0.0]])
    np.testing.assert_allclose(error[:2, :2], [[1.5e-6, np.nan], [np.nan, 1.5e-6]], atol=1e-9)
    assert np.isnan(error[2]).all() and np.isfinite(u[0, 0]) and np.isnan(u[0, 1:]).all()


@pytest.mark.long
def test_an_own_effect_is_found_and_added(session: mtcal.Measurement, fit: mtcal.Fit) -> None:
    bend = mtcal.Effect(
        "bend", "q * x * (0.4 - x) * dir_x", enters="x", coefficients={"q": {"unit": "1/m", "low": -1e-3, "high": 1e-3}}
    )
    assert repr(bend) == "<Effect bend: e_x = q * x * (0.4 - x) * dir_x>"
    assert "bend" in mtcal.catalogue([bend]).index
    assert "bend" not in mtcal.catalogue().index
    known = mtcal.identify(session, own=[bend])
    assert known.effects == ()
    assert "bend" in known.diagnose().probability
    added = known.add(["backlash_x", "bend"])
    assert added.effects == ("backlash_x", "bend")
    assert fit.add(bend).parameters.loc["bend.q", "determined"]
    np.testing.assert_allclose(fit.add(bend).result.fit.residuals, known.add("bend").result.fit.residuals)


@pytest.mark.long
def test_bad_input_is_one_line(session: mtcal.Measurement, fit: mtcal.Fit, tmp_path: Path) -> None:
    def own(formula: str) -> mtcal.Effect:
        return mtcal.Effect("mine", formula, enters="x", coefficients={"q": ("m", -1.0, 1.0)})

    other = mtcal.identify(mtcal.simulate("straightness", seed=4))
    cases = {
        "nothing to load": lambda: mtcal.load(),
        "not int": lambda: mtcal.load(5),  # type: ignore[arg-type]
        "no such file or folder": lambda: mtcal.identify(tmp_path / "nowhere"),
        "neither a session": lambda: mtcal.load(tmp_path),
        "no plan 'stars'": lambda: mtcal.simulate("stars"),
        "stars": lambda: mtcal.simulate("iso230_2", stars=3),
        "does not occur in direct": lambda: mtcal.simulate("iso230_2", effects="dead_path"),
        "unknown effect 'backlsh'": lambda: mtcal.identify(session, effects="backlsh"),
        "named twice": lambda: mtcal.identify(session, effects="backlash_x").add("backlash_x"),
        "two effects of yours have the name": lambda: mtcal.catalogue([own("q * dir_x"), own("q * dir_x")]),
        "does not hold the coefficient": lambda: own("dir_x"),
        "effect mine: enters": lambda: mtcal.Effect("mine", "q", enters="w", coefficients={"q": ("m", -1.0, 1.0)}),
        "no picture 'stars'; there are": lambda: fit.plot("stars"),
        "no picture 'moon'; there are": lambda: fit.compare().plot("moon"),
        "there is no covariate": lambda: fit.compare().plot(against=["moon"]),
        "of a list of fits": lambda: mtcal.plot_improvement([]),
        "of the same measurement": lambda: mtcal.plot_improvement([fit, other]),
    }
    for words, wrong in cases.items():
        with pytest.raises(mtcal.CalibrationError, match=words) as caught:
            wrong()
        assert "\n" not in str(caught.value)
    with pytest.raises(ModelError):
        mtcal.identify(session, model="stars")


def test_a_folder_keeps_its_whole_name(tmp_path: Path) -> None:
    """Folders are often named by a date: 2026.03.01 and 2026.03.02 are no repetition of 2026.03."""
    folders = [tmp_path / "2026.03.01", tmp_path / "2026.03.02"]
    for seed, folder in enumerate(folders):
        mtcal.simulate("iso230_2", seed=seed).save(folder)
    assert mtcal.load(folders).labels == ("2026.03.01", "2026.03.02")


def test_what_was_declared_is_said_with_its_growth_along_the_path(tmp_path: Path) -> None:
    """And the scatter is held against all of it, not against the part that does not grow."""
    mtcal.simulate("iso230_2", repeats=2, seed=3).save(tmp_path / "run")
    file = tmp_path / "run" / "session.yaml"
    text = file.read_text(encoding="utf-8")
    file.write_text(
        text.replace("{displacement: 2.0e-07}", "{displacement: 2.0e-07, per_length: 5.0e-6}"), encoding="utf-8"
    )
    fit = mtcal.identify(mtcal.load(tmp_path / "run"))
    assert "declared standard uncertainty 0.200 µm + 5.00 µm/m of the path" in " ".join(fit.report().split())
    scatter = fit.document()["error_map"]["scatter"]
    assert 1e-6 < scatter["declared"] < 2e-6
    assert scatter["found"] == pytest.approx(scatter["declared"] * fit.reduced_chi_square**0.5)


COEFFICIENT = {"b": ("1", -1.0, 1.0)}
WRONG: list[tuple[Callable[[Any], object], str]] = [
    (lambda run: run.budget(draws=-5), "draws must be a whole number"),
    (lambda run: run.budget(draws=True), "draws must be a whole number from 0 to 100000, not True"),
    (lambda run: run.budget(quantities=None), "quantities must be a list, not nothing"),
    (lambda run: run.features(distances=[None]), "an entry of distances or angles must be a list of names"),
    (lambda run: run.features(frame=""), "frame has 0 names, not 2"),
    (lambda run: run.plot(np.zeros(3)), "no picture array([0., 0., 0.]); there are"),
    (lambda run: run.conformity({"EXX": 1e-5}, rule=np.zeros(3)), "no decision rule array"),
    (lambda run: mtcal.simulate("iso230_2", machine={}), "machine must be a file, not"),
    (lambda run: run.budget(["reading"]), "contributor 1: the content must be a mapping of keys"),
    (lambda run: run.features(draws="many"), "draws must be a whole number from 0 to 100000, not 'many'"),
    (lambda run: run.compare_map("other_session"), "the other map must be that of a fit"),
    (lambda run: run.compare_map(run, seed=-1), "seed must be a whole number from 0 to"),
    (lambda run: run.compare_map(run, seed=1.5), "seed must be a whole number"),
    (lambda run: run.conformity(["EXX"]), "tolerances must be a mapping"),
    (lambda run: run.conformity({}), "no tolerance is given"),
    (lambda run: run.conformity({"EXX": None}), "the tolerance of EXX must be"),
    (lambda run: run.conformity({"EXX": True}), "the tolerance of EXX must be a number or a text"),
    (lambda run: run.budget([]), "contributors has 0 entries"),
    (lambda run: run.conformity({"EXX": 1e-5}, budget="mine.yaml"), "budget must be one, as Fit.budget gives it"),
    (lambda run: run.conformity({1: 1e-5}), "'1' is no figure with a tolerance"),
    (lambda run: run.conformity({"EXX": 1e-5}, rule=None), "no decision rule None; there are"),
    (lambda run: run.conformity({"EXX": 1e-5}, level=None), "level must be a number, not nothing"),
    (lambda run: run.budget(3), "contributors must be a list, not 3"),
    (lambda run: run.compare_map(run, None), "labels must be a list of two names, not nothing"),
    (lambda run: run.compare_map(run, ("a", "b", "c")), "labels must be two names, not 3"),
    (lambda run: run.add(None), "effects must be a list, not nothing"),
    (lambda run: run.plot(["residuals"]), "no picture ['residuals']; there are"),
    (lambda run: run.compare().plot(against=2), "against must be a list, not 2"),
    (lambda run: run.save_pictures(None), "folder must be a path, not nothing"),
    (lambda run: run.measurement.save(3), "folder must be a path, not 3"),
    (lambda run: mtcal.identify(run.measurement, model=3), "a model must be a name, not 3"),
    (lambda run: mtcal.identify(run.measurement, model={1: 2}), "a model must be a name, not {1: 2}"),
    (
        lambda run: mtcal.identify(run.measurement, own=["creep"]),
        "own must be a list of effects, as mtcal.Effect makes",
    ),
    (lambda run: mtcal.catalogue(None), "own must be a list of effects, as mtcal.Effect makes them, not nothing"),
    (lambda run: mtcal.simulate(["iso230_2"]), "plan must be a name"),
    (lambda run: mtcal.improve(run.measurement).probability("backlash_x"), "no effect 'backlash_x' was added"),
    (lambda run: run.error_at("here"), "positions must be numbers"),
    (lambda run: run.error_at([[0.0, 0.0, 0.0], [0.0]]), "positions must be numbers"),
    (lambda run: mtcal.Effect("e", "b * x", enters="x", coefficients=["b"]), "coefficients must be a mapping"),
    (
        lambda run: mtcal.Effect("e", "b * x * k", enters="x", coefficients=COEFFICIENT, constants={"k": 2.0}),
        "constants.k must be a mapping of keys, not 2.0",
    ),
]


@pytest.fixture(scope="module")
def run() -> mtcal.Fit:
    return mtcal.identify(mtcal.simulate("iso230_2", repeats=2, seed=3))


@pytest.mark.long
@pytest.mark.parametrize(("call", "message"), WRONG)
def test_what_cannot_be_is_named(run: mtcal.Fit, call: Callable[[Any], object], message: str) -> None:
    with pytest.raises(mtcal.CalibrationError) as caught:
        call(run)
    assert message in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.long
def test_numbers_of_numpy_are_numbers(run: mtcal.Fit) -> None:
    assert run.compare_map(mtcal.identify(mtcal.simulate("iso230_2", repeats=2, seed=4)), seed=np.int64(3)).count


def test_far_beyond_what_was_measured_there_is_no_error(run: mtcal.Fit) -> None:
    error, u = run.error_at([np.inf, 0.0, 0.0])
    assert np.isnan(error).all() and np.isnan(u).all()


LINES = [
    {"name": "touch", "type": "B", "standard_uncertainty": 1e-6, "enters": "reading", "varies": "reading"},
    {"name": "scale", "type": "B", "standard_uncertainty": 5e-6, "enters": "length", "varies": "never"},
]


@pytest.fixture(scope="module")
def part(tmp_path_factory: pytest.TempPathFactory) -> mtcal.Fit:
    """Of a part that was probed."""
    folder = tmp_path_factory.mktemp("probing") / "session"
    mtcal.simulate("probing_cross", seed=2).save(str(folder))
    return mtcal.identify(str(folder))


def test_tables_hold_together(part: mtcal.Fit) -> None:
    """Shares make one, squares of the contributions that of the sum; U is twice that, or what the readings show."""
    budget = part.budget(LINES, quantities=["position_error", "workpiece_form"])
    assert list(budget.contributors.index) == ["touch", "scale", "known besides the readings"]
    for (name, which), own in budget.contributions.groupby(["name", "which"]):
        told = budget.quantities.set_index(["name", "which"]).loc[(name, which)]
        assert own["share"].sum() == pytest.approx(1.0)
        assert np.sqrt((own["u"] ** 2).sum()) == pytest.approx(told["u"])
        assert told["U"] == pytest.approx(2.0 * max(told["u"], told["u_identification"]))
    assert "position_error, U = " in repr(budget)
    assert "what they contribute" in budget.report()
    assert budget.document()["format"] == "mtcal-budget-result/1"
    assert budget.plot().axes


def test_a_file_and_the_instrument(part: mtcal.Fit, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    line = "- {name: a, type: B, standard_uncertainty: 1.0e-6, enters: reading, varies: reading}"
    path.write_text(f"format: mtcal-budget/1\ncontributors:\n{line}\n", encoding="utf-8")
    assert "a" in part.budget(path).contributors.index
    assert "one touch" in part.budget().contributors.index


@pytest.mark.long
def test_conformity(part: mtcal.Fit) -> None:
    found = part.conformity({"ECC": "10 mrad", "C0Y": 0.1, "EXC": 1e-9})
    assert list(found.verdicts.columns) == ["tolerance", "value", "u", "unit", "probability", "decision", "why"]
    assert list(found.verdicts["decision"])[::2] == ["pass", "fail"]
    assert found.decision == "fail"
    assert repr(found).startswith("<Conformity: conformity: fail (ECC pass, ")
    assert "All together: fail." in found.report()
    assert found.document()["figures"][0]["tolerance"] == pytest.approx(0.01)
