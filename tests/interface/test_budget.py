# SPDX-License-Identifier: Apache-2.0
"""Budget and conformity of a fit as tables."""

from pathlib import Path

import numpy as np
import pytest

import machine_tool_calibration as mtcal

LINES = [
    {"name": "touch", "type": "B", "standard_uncertainty": 1e-6, "enters": "reading", "varies": "reading"},
    {"name": "scale", "type": "B", "standard_uncertainty": 5e-6, "enters": "length", "varies": "never"},
]


@pytest.fixture(scope="module")
def fit(tmp_path_factory: pytest.TempPathFactory) -> mtcal.Fit:
    """Of a part that was probed."""
    folder = tmp_path_factory.mktemp("probing") / "session"
    mtcal.simulate("probing_cross", seed=2).save(str(folder))
    return mtcal.identify(str(folder))


def test_tables_hold_together(fit: mtcal.Fit) -> None:
    """Shares make one, squares of the contributions the square of the sum, and twice that is U."""
    budget = fit.budget(LINES, quantities=["position_error", "workpiece_form"])
    assert list(budget.contributors.index) == ["touch", "scale", "known besides the readings"]
    for (name, which), own in budget.contributions.groupby(["name", "which"]):
        told = budget.quantities.set_index(["name", "which"]).loc[(name, which)]
        assert own["share"].sum() == pytest.approx(1.0)
        assert np.sqrt((own["u"] ** 2).sum()) == pytest.approx(told["u"])
        assert told["U"] == pytest.approx(2.0 * told["u"])
    assert "position_error, U = " in repr(budget)
    assert "what they contribute" in budget.report()
    assert budget.document()["format"] == "mtcal-budget-result/1"
    assert budget.plot().axes


def test_a_file_and_the_instrument(fit: mtcal.Fit, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    line = "- {name: a, type: B, standard_uncertainty: 1.0e-6, enters: reading, varies: reading}"
    path.write_text(f"format: mtcal-budget/1\ncontributors:\n{line}\n", encoding="utf-8")
    assert "a" in fit.budget(path).contributors.index
    assert "one touch" in fit.budget().contributors.index


def test_conformity(fit: mtcal.Fit) -> None:
    found = fit.conformity({"ECC": "10 mrad", "C0Y": 1.0, "EXC": 1e-9})
    assert list(found.verdicts.columns) == ["tolerance", "value", "u", "unit", "probability", "decision", "why"]
    assert list(found.verdicts["decision"])[::2] == ["pass", "fail"]
    assert found.decision == "fail"
    assert repr(found).startswith("<Conformity: conformity: fail (ECC pass, ")
    assert "All together: fail." in found.report()
    assert found.document()["figures"][0]["tolerance"] == pytest.approx(0.01)


def test_wrong_lines_and_names(fit: mtcal.Fit) -> None:
    with pytest.raises(mtcal.CalibrationError, match="contributor 2: varies is 'day', not 'reading'"):
        fit.budget([LINES[0], {**LINES[1], "varies": "day"}])
    with pytest.raises(mtcal.CalibrationError, match="contributor 1: one of standard_uncertainty"):
        fit.budget([{**LINES[0], "half_width": 1.0}])
    with pytest.raises(mtcal.CalibrationError, match="'work' is not published of this measurement"):
        fit.budget(LINES, quantities="work")
    with pytest.raises(mtcal.CalibrationError, match="tolerance of ECC: '10 um' is not of the dimension angle"):
        fit.conformity({"ECC": "10 um"})
