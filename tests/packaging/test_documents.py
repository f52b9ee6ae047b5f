# SPDX-License-Identifier: Apache-2.0
"""What README, guides, formats and CONTRIBUTING say is so, and their commands and examples run."""

import json
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel

from machine_tool_calibration.cli.main import _built_in, run
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.effect import Effect
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.model.result import Estimate
from machine_tool_calibration.session import description
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.parse import parse_description
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.table import LABEL_COLUMNS, NUMERIC_COLUMNS
from machine_tool_calibration.simulation import PRESETS, SimulationSpec, simulate
from machine_tool_calibration.simulation.machine_file import machine_document, read_machine

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


def keys(value: object) -> set[str]:
    """Of a part of a document, at any depth."""
    if isinstance(value, dict):
        return set(value).union(*map(keys, value.values()))
    return set[str]().union(*map(keys, value)) if isinstance(value, list) else set()


def documented(verb: str, key: str) -> set[str]:
    """The words of what docs/results.md says of a key of a verb's document, or where it refers to."""
    part = next(part for part in RESULTS.split("## `mtcal ") if part.startswith(f"{verb} "))
    (row,) = [row for row in part.splitlines() if row.startswith("| `") and f"`{key}`" in row.split("|")[1]]
    refers = "as for `identify`" in row or ", below" in row
    return words(RESULTS.partition("## `mtcal compare ")[0] if refers else row)


@pytest.mark.long
@pytest.mark.parametrize("verb", ["identify", "diagnose"])
def test_every_key_of_a_document_is_named(verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    session = shutil.copytree(SESSION, tmp_path / "session")
    lines = (session / "observations.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    at = lines[0].strip().split(",").index("displacement")
    row = lines[30].split(",")
    row[at] = str(float(row[at]) + 5e-5)  # one that is set aside
    (session / "observations.csv").write_text("".join([*lines[:30], ",".join(row), *lines[31:]]), encoding="utf-8")
    assert run([verb, str(session), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    by_method = {"error_map"}  # of which each method has its own
    for key in document:
        told = documented(verb, key)
        assert key in by_method or set().union(*map(words, keys(document[key]))) <= told, key
    full = {"separate_by", "outliers", "visible_by", "detectable"} if verb == "diagnose" else {"rejected", "parameters"}
    assert all(document[key] for key in full)


README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_readme_shows_what_diagnose_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (simulate,) = re.findall(r"^mtcal (simulate .*--effect.*)$", README, re.MULTILINE)
    assert run(shlex.split(simulate)) == 0
    capsys.readouterr()
    assert run(["diagnose", "session"]) == 0
    (shown,) = re.findall(r"```text\n(The model lacks.*?)```", README, re.DOTALL)
    assert capsys.readouterr().out.split() == shown.split()


def test_all_presets_measure_the_machine_of_the_readme() -> None:
    (file,) = re.findall(r"--machine (config/machines/\S+\.yaml)", README)
    specs = [SimulationSpec(plan=plan, machine=read_machine(ROOT / file)) for plan in PRESETS.values()]
    first, *others = [machine_document(simulate(spec).truth.machine) for spec in specs]
    assert len(others) > 10 and all(other == first for other in others)


def test_every_command_of_the_readme_exists_and_the_other_way_round() -> None:
    named = set(re.findall(r"^\| `mtcal ([a-z-]+)", README, re.MULTILINE))
    used = set(re.findall(r"mtcal ([a-z][a-z-]*)", README))
    verbs = set(_built_in())
    assert used <= verbs
    assert named == verbs, "the README's table has each verb once"


def test_every_file_and_folder_of_the_readme_exists() -> None:
    paths = re.findall(r"`((?:[\w.-]+/)+[\w.-]*|[A-Z]+\.\w+)`", README) + re.findall(r"\]\(([^):]+)\)", README)
    assert len(paths) > 4
    made = (".venv/", "mtcal_output/")
    assert not [path for path in paths if not (ROOT / path).exists() and not path.startswith(made)]


def test_ci_runs_the_command_of_the_readme() -> None:
    command = re.findall(r"^python3 scripts/bootstrap.py test\b", README, re.MULTILINE)
    assert len(command) == 1
    assert f"exec {command[0]}" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


GUIDES = sorted((ROOT / "docs" / "guides").glob("*.md"))


@pytest.mark.long(but=("index",))
@pytest.mark.usefixtures("rough_pictures", "found_once")
@pytest.mark.parametrize("guide", GUIDES, ids=lambda guide: guide.stem)
def test_a_guide_runs_from_top_to_bottom(
    guide: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "500")  # sentences in one line
    text = guide.read_text(encoding="utf-8")
    for name, content in re.findall(r"^```\w+ (\S+\.\w+)\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        Path(name).write_text(content, encoding="utf-8")
    lines = [
        line
        for block in re.findall(r"^```bash\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
        for line in block.splitlines()
    ]
    commands = [shlex.split(line, comments=True) for line in lines if line.strip()]
    assert commands
    for verb, *arguments in commands:
        assert verb == "mtcal"
        assert run(arguments) == 0, shlex.join(arguments)
    said = capsys.readouterr().out
    for sentence in re.findall(r"^> (.*)$", text, re.MULTILINE):
        assert sentence in said


@pytest.fixture
def effect() -> Effect:
    code = re.findall(r"```python\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.DOTALL)
    assert len(code) == 1
    names: dict[str, object] = {}
    exec(compile(code[0], "CONTRIBUTING.md", "exec"), names)
    made = names["QuadraticDrift"]
    assert isinstance(made, type) and issubclass(made, Effect)
    return made()


@pytest.fixture
def session() -> Session:
    return read_session(ROOT / "tests" / "data" / "tracking_2d")


def drifting(session: Session, rate: float) -> Session:
    """The session with a drift of rate * time^2, counted from the first reading of each setup as readings are."""
    readings = session.readings
    drift = rate * readings.column("time") ** 2
    for setup in np.unique(readings.setup):
        mine = readings.setup == setup
        drift[mine] -= drift[mine][0]
    return session.with_readings(replace(readings, displacement=readings.displacement + drift))


def estimate(session: Session, effect: Effect) -> Estimate:
    result = identify(session, effects=[effect.id], own=[effect])
    (found,) = [parameter for parameter in result.parameters if effect.id in parameter.name]
    return found


def test_the_example_effect_is_recovered(effect: Effect, session: Session) -> None:
    rate = 5e-12
    before, after = estimate(session, effect), estimate(drifting(session, rate), effect)
    assert rate > 10 * before.standard_uncertainty
    assert abs(before.value) < 4 * before.standard_uncertainty
    assert after.value - before.value == pytest.approx(rate, abs=0.01 * rate)


def test_the_example_effect_is_an_effect_like_the_others(effect: Effect) -> None:
    assert effect.id not in catalogue()
    assert effect.id in catalogue([effect])
    assert effect.id and effect.title and effect.formula and effect.source
