# SPDX-License-Identifier: Apache-2.0
"""Whatever was read, what is wrong in it is said in the same words."""

from pathlib import Path

import pytest

from machine_tool_calibration.budget.contributor import read_budget
from machine_tool_calibration.effects.formula import read_effects
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.importing.text_table import parse_form
from machine_tool_calibration.nodes.site import read_site
from machine_tool_calibration.reports.history_file import read_history
from machine_tool_calibration.simulation.machine_file import read_machine
from machine_tool_calibration.simulation.spec import read_spec, spec_from

EFFECT = "effects:\n- {{id: creep, enters: reading, formula: r * time, coefficients: {{r: {{unit: m/s, {} 1e-9}}}}}}\n"


@pytest.mark.parametrize(
    ("read", "text", "said"),
    [
        (read_effects, EFFECT.format("low: many, high:"), "low must be a finite number, not 'many'"),
        (read_effects, EFFECT.format("low: -1e-9, hihg:"), "(did you mean 'high'?)"),
        (read_spec, "plan: {method: direct}\nnoise: -1\n", "line 2: noise must be greater than 0, not -1"),
        (read_spec, "plan: {method: direct}\nnoize: 1e-7\n", "line 2: unknown key 'noize' (did you mean 'noise'?)"),
        (read_spec, "plan: {method: direct}\ndirect: 1\n", "line 2: unknown key 'direct'"),
        (read_machine, "probing: 1\n", "line 1: unknown key 'probing'"),
        (lambda path: read_site(str(path)), "seed: -1\n", "line 1: seed must be at least 0, not -1"),
        (lambda path: read_site(str(path)), "sead: 1\n", "line 1: unknown key 'sead' (did you mean 'seed'?)"),
        (read_history, "format: mtcal-history/1\nmodels: 3\n", "line 2: models must be a list, not 3; mend the file"),
        (read_budget, "format: mtcal-budget/1\ncontributors: []\n", "line 2: contributors has 0 entries"),
    ],
)
def test_one_line_names_place_and_key(read, text, said, tmp_path: Path) -> None:
    file = tmp_path / "file.yaml"
    file.write_text(text)
    with pytest.raises(CalibrationError) as caught:
        read(file)
    message = str(caught.value)
    assert said in message and message.startswith(str(file)) and "\n" not in message


def test_what_comes_from_no_file_has_no_place() -> None:
    with pytest.raises(CalibrationError, match=r"^noise must be greater than 0, not -1\.0$"):
        spec_from(None, method="direct", fields={"noise": -1.0})
    with pytest.raises(CalibrationError, match=r"^skip must be at least 0, not -1$"):
        parse_form({"skip": -1})
