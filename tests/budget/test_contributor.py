# SPDX-License-Identifier: Apache-2.0
"""Contributors, and files of them: every mistake is one line that says what and where."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from machine_tool_calibration.budget.contributor import default_budget, read_budget, template, template_of
from machine_tool_calibration.errors import CalibrationError, ModelError, SessionError
from machine_tool_calibration.session.contributor import Contributor
from machine_tool_calibration.session.session import Session

GOOD = {"name": "a", "type": "B", "enters": "reading", "varies": "run"}


@pytest.mark.parametrize(
    ("said", "u"),
    [
        ({"standard_uncertainty": 2e-6}, 2e-6),
        ({"expanded": 6e-6, "coverage_factor": 3}, 2e-6),
        ({"half_width": 3e-6, "distribution": "rectangular"}, 3e-6 / np.sqrt(3.0)),
        ({"half_width": 3e-6, "distribution": "triangular"}, 3e-6 / np.sqrt(6.0)),
        ({"half_width": 3e-6, "distribution": "arcsine"}, 3e-6 / np.sqrt(2.0)),
    ],
)
def test_size_and_moments_of_the_draws(said: dict[str, Any], u: float) -> None:
    """Second and fourth moment within four standard deviations of their chance, ends where they are said."""
    one = Contributor(**GOOD, **said)
    assert one.u == pytest.approx(u)
    values = one.draw(np.random.default_rng(2), 40_000) / u
    assert np.mean(values) == pytest.approx(0.0, abs=4.0 / 200.0)
    assert np.mean(values**2) == pytest.approx(1.0, abs=4.0 * np.sqrt((one.fourth - 1.0) / 40_000))
    assert np.mean(values**4) == pytest.approx(one.fourth, rel=0.1)
    if one.half_width is not None:
        assert np.abs(values).max() * u <= 3e-6 * (1.0 + 1e-12)


def test_few_degrees_of_freedom_have_longer_tails() -> None:
    one = Contributor(**{**GOOD, "type": "A"}, standard_uncertainty=1e-6, degrees_of_freedom=5)
    values = one.draw(np.random.default_rng(2), 40_000) / 1e-6
    # Variance of Student's t: 5 / 3.
    assert np.var(values) == pytest.approx(5.0 / 3.0, rel=0.1)


HEAD = "format: mtcal-budget/1\ncontributors:\n"
LINE = "- {name: a, type: B, enters: reading, varies: run, standard_uncertainty: 1.0e-6"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("format: mtcal-session/1\n", "line 1: format is 'mtcal-session/1', not mtcal-budget/1"),
        ("format: mtcal-budget/1\ncontributors: []\n", "line 2: contributors has 0 entries, not at least 1"),
        (HEAD + LINE + ", size: 3}\n", r"line 3: unknown key 'contributors\[0\].size'"),
        (HEAD + LINE.replace("type: B", "type: C") + "}\n", r"contributors\[0\].type is 'C', not 'A' or 'B'"),
        (HEAD + LINE.replace("1.0e-6", "-1.0e-6") + "}\n", "standard_uncertainty must be greater than 0, not -1e-06"),
        (HEAD + LINE.replace("1.0e-6", "1 um") + "}\n", "standard_uncertainty must be a finite number, not '1 um'"),
        (
            HEAD + LINE.split(", standard")[0] + "}\n",
            "one of standard_uncertainty, expanded and half_width .* not none",
        ),
        (HEAD + LINE + ", half_width: 1}\n", "must be given, not standard_uncertainty and half_width"),
        (HEAD + LINE + ", coverage_factor: 2}\n", "expanded and coverage_factor belong together"),
        (HEAD + LINE.replace("standard_uncertainty", "half_width") + "}\n", "a normal distribution has no ends"),
        (HEAD + LINE + ", degrees_of_freedom: 0}\n", "degrees_of_freedom must be at least 1, not 0"),
        (HEAD + LINE.replace("1.0e-6", "0.5") + "}\n", "line 3: .*uncertainty of 0.5 m is none of .*SI units"),
        (HEAD + LINE + ", expansion: 1.0e-5}\n", "expansion .* belongs to what enters by temperature"),
        (
            HEAD + LINE.replace("enters: reading", "enters: temperature") + "}\n",
            "belongs to what enters by temperature",
        ),
        (HEAD + LINE + "}\n" + LINE + "}\n", "contributors has the name 'a' twice"),
        (HEAD + LINE + ", instrument: ruler}\n", r"contributors\[0\].instrument"),
    ],
)
def test_every_mistake_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "budget.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CalibrationError, match=message) as caught:
        read_budget(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_template_is_read_as_it_is_printed(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(template("touch_probe"), encoding="utf-8")
    assert read_budget(path) == template_of("touch_probe")


def test_instruments_without_a_budget(runs: Callable[..., Session]) -> None:
    with pytest.raises(
        ModelError, match=r"no budget for the instrument 'laser_traker' \(did you mean 'laser_tracker'\?\)"
    ):
        template("laser_traker")
    with pytest.raises(ModelError, match="does not name its instrument: `instrument` in session"):
        default_budget([runs()])


def test_budgets_of_two_instruments_stay_apart(runs: Callable[..., Session]) -> None:
    both = default_budget([runs(instrument=name) for name in ("laser_tracker", "touch_probe", "laser_tracker")])
    assert {c.instrument for c in both} == {"laser_tracker", "touch_probe"}
    assert len({c.name for c in both}) == len(both) == len(template_of("laser_tracker")) + 3


def test_a_session_states_its_own_budget(runs: Callable[..., Session]) -> None:
    line = {"name": "scale", "type": "B", "standard_uncertainty": 2e-6, "enters": "length", "varies": "never"}
    own = runs(instrument="laser_interferometer", budget=[line])
    assert [c.name for c in default_budget([own])] == ["scale"]
    with pytest.raises(ModelError, match="sessions of one instrument, laser_interferometer, state different budgets"):
        default_budget([own, runs(instrument="laser_interferometer")])
    with pytest.raises(SessionError, match="contributors has the name 'scale' twice"):
        runs(budget=[line, line])
