# SPDX-License-Identifier: Apache-2.0
"""docs/sessions.md and docs/results.md say what is read and written."""

import json
import re
from pathlib import Path

import pytest
from pydantic import BaseModel

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.session import description
from machine_tool_calibration.session.parse import parse_description
from machine_tool_calibration.session.table import LABEL_COLUMNS, NUMERIC_COLUMNS

ROOT = Path(__file__).parents[2]
SESSIONS = (ROOT / "docs" / "sessions.md").read_text(encoding="utf-8")
RESULTS = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```yaml\n(.*?)```", SESSIONS, re.DOTALL)
SESSION = str(ROOT / "tests" / "data" / "tracking_2d")


def words(text: str) -> set[str]:
    return set(re.findall(r"\w+", text))


@pytest.mark.parametrize("text", EXAMPLES)
def test_every_example_is_a_session(text: str) -> None:
    parse_description(text, "docs/sessions.md")


def test_every_method_has_an_example() -> None:
    shown = {parse_description(text, "docs/sessions.md").method for text in EXAMPLES}
    assert shown == {"step_diagonal", "tracking_interferometer", "rotary_axis", "probing", "direct", "ball_bar"}


def test_every_key_and_column_is_named() -> None:
    records = [
        value for value in vars(description).values() if isinstance(value, type) and issubclass(value, BaseModel)
    ]
    keys = {key for record in records for key in record.model_fields}
    assert "stylus_diameter" in keys
    assert keys | {*LABEL_COLUMNS, *NUMERIC_COLUMNS} <= words(SESSIONS)


@pytest.mark.parametrize("verb", ["identify", "diagnose"])
def test_every_key_of_a_document_is_named(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([verb, SESSION, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    part = next(part for part in RESULTS.split("## `mtcal ") if part.startswith(f"{verb} "))
    own = {"fit", "method", "observations", "structure_left"}
    assert set(document) - own <= words(part)
    assert {"format", "candidates" if verb == "diagnose" else "error_map"} <= set(document)
