# SPDX-License-Identifier: Apache-2.0
"""The whole loop for every method; tables, documents and texts are those of the command line."""

import json
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import machine_tool_calibration as mtcal

from ..told import Verb

MACHINE = Path(__file__).parents[2] / "config" / "machines" / "five_axis_vertical.yaml"
SESSIONS: dict[str, dict[str, Any]] = {
    "tracking_interferometer": {"plan": "paper_003", "effects": {"backlash_y": 2e-6}, "repeats": 1},
    "rotary_axis": {"plan": "rotary_axis", "repeats": 1, "angles": list(range(6))},
    "probing": {"plan": "probing_cross", "repeats": 1, "angles": [0.0, 1.5]},
    "direct": {"plan": "iso230_2", "effects": {"backlash_x": 1.5e-6}, "repeats": 2},
    "step_diagonal": {"plan": "step_diagonal", "repeats": 1, "blocks": 4},
}


@pytest.fixture(scope="module", params=SESSIONS)
def folder(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    path = tmp_path_factory.mktemp("loop") / request.param
    mtcal.simulate(seed=3, **SESSIONS[request.param]).save(path)
    yield path


@pytest.fixture(scope="module")
def fit(folder: Path) -> mtcal.Fit:
    return mtcal.identify(folder)


def numbers(values: Any) -> np.ndarray:
    """A list of a document, where None is NaN."""
    return np.array(values, dtype=float)


def motion(fit: mtcal.Fit, name: str) -> pd.DataFrame:
    return fit.error_motions[fit.error_motions["motion"] == name]


@pytest.mark.long
def test_identify_says_what_the_command_says(folder: Path, fit: mtcal.Fit, verb: Verb) -> None:
    document = verb("identify", str(folder), "--json").document
    assert json.loads(json.dumps(fit.document())) == document
    assert fit.report() == verb("identify", str(folder)).out
    known = fit.parameters[fit.parameters["determined"]]
    assert [*known.index] == [entry["name"] for entry in document["parameters"]]
    np.testing.assert_array_equal(known["value"], [entry["value"] for entry in document["parameters"]])
    np.testing.assert_array_equal(known["u"], [entry["standard_uncertainty"] for entry in document["parameters"]])
    lost = fit.parameters[~fit.parameters["determined"]]
    assert [*lost.index] == [entry["name"] for entry in document["not_determined"]]
    assert lost[["value", "u"]].isna().all(axis=None)
    assert (lost["why_not"] != "").all()
    assert np.sqrt(np.mean(fit.residuals["residual"] ** 2)) == pytest.approx(document["rms_residual"], rel=1e-12)
    assert fit.rms_residual == document["rms_residual"]
    assert fit.reduced_chi_square == document["reduced_chi_square"]


def test_the_map_is_that_of_the_document(fit: mtcal.Fit) -> None:
    content, frame = fit.document()["error_map"], fit.error_map
    error, u = frame[["ex", "ey", "ez"]].to_numpy(), frame[["ux", "uy", "uz"]].to_numpy()
    known = frame[[f"determined_{axis}" for axis in "xyz"]].to_numpy()
    np.testing.assert_array_equal(known, np.isfinite(error))
    np.testing.assert_array_equal(known, np.isfinite(u))
    assert known.any()
    if fit.measurement.method == "step_diagonal":
        expected, expected_u = (np.concatenate([content[f"{a}{end}"] for a in "xyz"]) for end in ("", "_u"))
        assert [*frame["axis"].unique()] == ["x", "y", "z"]
    else:
        expected, expected_u = numbers(content["position_error"]), numbers(content["position_error_u"])
    dimension = expected.shape[1]
    np.testing.assert_array_equal(error[:, :dimension], expected)
    np.testing.assert_array_equal(u[:, :dimension], expected_u)
    assert not known[:, dimension:].any()
    if "points" in content:
        np.testing.assert_array_equal(frame[["x", "y", "z"]], content["points"])


def test_error_motions_are_those_of_the_document(fit: mtcal.Fit) -> None:
    content, frame = fit.document()["error_map"], fit.error_motions
    assert (frame["determined"] == frame["value"].notna()).all()
    method = fit.measurement.method
    if method == "tracking_interferometer":
        assert frame.empty
        assert "EXX" in set(mtcal.identify(fit.measurement, model="rigid_body").error_motions["motion"])
    elif method == "direct":
        assert set(frame["motion"]) == {"EXX"}
        np.testing.assert_array_equal(frame["value"], numbers(content["tables"]["EXX"]["value"]))
        np.testing.assert_array_equal(frame["u"], numbers(content["tables"]["EXX"]["value_u"]))
        np.testing.assert_array_equal(frame["position"], content["tables"]["EXX"]["nodes"])
    elif method == "step_diagonal":
        for j, name in enumerate(("EXX", "EYX", "EZX")):
            np.testing.assert_array_equal(motion(fit, name)["value"], numbers(content["x"])[:, j])
            np.testing.assert_array_equal(motion(fit, name)["u"], numbers(content["x_u"])[:, j])
            np.testing.assert_array_equal(motion(fit, name)["position"], content["x_position"])
        assert motion(fit, "C0Y")["u"].item() == content["squareness"]["C0Y_u"]
        assert motion(fit, "C0Y")["unit"].item() == "rad"
    else:
        for name in ("EXC", "EYC", "ECC"):
            np.testing.assert_array_equal(motion(fit, name)["value"], numbers(content[name]))
            np.testing.assert_array_equal(motion(fit, name)["u"], numbers(content[f"{name}_u"]))
            np.testing.assert_array_equal(motion(fit, name)["position"], content["c"])
            assert set(motion(fit, name)["position_unit"]) == {"rad"}
        assert set(motion(fit, "ECC")["unit"]) == {"rad"}
        assert set(motion(fit, "EXC")["unit"]) == {"m"}
    if method == "probing":
        np.testing.assert_array_equal(fit.workpiece["error"], numbers(content["workpiece_error"]))
        np.testing.assert_array_equal(fit.workpiece["u_form"], numbers(content["workpiece_form_u"]))
        assert [*fit.workpiece.index] == content["workpiece_points"]
    else:
        assert fit.workpiece.empty


@pytest.mark.long
def test_compare_says_what_the_command_says(folder: Path, fit: mtcal.Fit, verb: Verb) -> None:
    assert fit.rejected.empty  # the command holds the model against all readings
    comparison = fit.compare()
    document = verb("compare", str(folder), "--json").document
    assert json.loads(json.dumps(comparison.document())) == document
    assert [*comparison.setups["name"]] == [entry["name"] for entry in document["setups"]]
    np.testing.assert_array_equal(
        comparison.setups["mean"].astype(float), numbers([entry["mean"] for entry in document["setups"]])
    )
    np.testing.assert_array_equal(comparison.residuals["residual"], fit.residuals["residual"])
    assert len(comparison.regions) == len(document["regions"])
    assert len(comparison.trends) == len(document["trends"])


@pytest.mark.long(but=("direct",))
def test_the_loop(folder: Path, fit: mtcal.Fit) -> None:
    if folder.name == "tracking_interferometer":  # whose diagnosis is in docs/python.md
        assert fit.add("backlash_y").parameters.loc["backlash_y.b", "determined"]
        return
    diagnosis = fit.diagnose()
    assert diagnosis.probability.between(0, 1).all()
    better = fit.add(diagnosis.effects)
    assert better.effects == diagnosis.effects
    if folder.name == "direct":
        ((put_in, truth),) = SESSIONS["direct"]["effects"].items()
        assert diagnosis.effects == (put_in,)
        assert diagnosis.verdict == "missing_effect"
        assert better.rms_residual < 0.3 * fit.rms_residual
        size = better.parameters.loc[f"{put_in}.b"]
        assert abs(size["value"] - truth) < 4 * size["u"]
        assert f"{put_in} (probability" in repr(diagnosis)
    else:
        assert (diagnosis.verdict, diagnosis.effects) == ("adequate", ())
        assert better.rms_residual == fit.rms_residual
    assert better.plot().canvas.manager is None  # no window
    figure = mtcal.plot_improvement([fit, better])
    assert figure.axes[0].get_title() == "The error falls"


@pytest.mark.long
def test_frames_of_an_improvement_are_those_of_its_document() -> None:
    improvement = mtcal.improve(mtcal.simulate(seed=3, **SESSIONS["direct"]))
    diagnosis, document = improvement.diagnosis, improvement.document()
    for entry in diagnosis.document()["candidates"]:
        assert diagnosis.probability[entry["effect"]] == entry["probability"]
    assert diagnosis.candidates.loc["backlash_x", "plausible"] and 0 <= diagnosis.nothing < 0.01
    rms = [step["rms_residual"] for step in document["steps"]]
    np.testing.assert_array_equal(improvement.history["rms_residual"], rms)
    assert diagnosis.effects == improvement.best.effects == ("backlash_x",)
    assert improvement.best.document() == document["result"]
    for shown in (diagnosis, improvement):
        assert "\n" not in repr(shown) and shown.report() in unescape(shown._repr_html_())
        assert shown.plot().canvas.manager is None


@pytest.mark.long
def test_several_sessions(tmp_path: Path, verb: Verb) -> None:
    for name, plan in (("square", {"plan": "grid_plate", "count": 5}), ("line", {"plan": "iso230_2"})):
        mtcal.simulate(**plan, repeats=1, seed=2, machine=MACHINE).save(tmp_path / name)  # type: ignore[arg-type]
    paths = [tmp_path / "square", tmp_path / "line"]
    session = mtcal.load(*paths)
    assert mtcal.load(paths).labels == session.labels == ("square", "line")
    assert [*session.readings["session"].unique()] == ["square", "line"]
    fit = mtcal.identify(session)
    words = [str(path) for path in paths]
    document = verb("identify", *words, "--json").document
    assert json.loads(json.dumps(fit.document())) == document
    assert fit.report() == verb("identify", *words).out
    content = document["error_map"]
    np.testing.assert_array_equal(fit.error_map[["ex", "ey", "ez"]], numbers(content["position_error"]))
    np.testing.assert_array_equal(fit.error_map[["ux", "uy", "uz"]], numbers(content["position_error_u"]))
    np.testing.assert_array_equal(motion(fit, "EXX")["value"], numbers(content["tables"]["EXX"]["value"]))
    assert motion(fit, "C0Y")["value"].item() == content["tables"]["C0Y"]["value"]
    comparison = fit.compare()
    assert comparison.report() == verb("compare", *words).out
    assert {*comparison.trends["session"]} == {"square", "line"}
    assert len(comparison.residuals) == len(fit.residuals) == document["used"]
    assert fit.plot("error_motions").canvas.manager is None
    assert comparison.plot("residual_map", session="line").canvas.manager is None
