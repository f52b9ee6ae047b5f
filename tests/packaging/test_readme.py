# SPDX-License-Identifier: Apache-2.0
"""The README says what there is."""

import re
from pathlib import Path

from machine_tool_calibration.cli.main import _built_in

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


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
