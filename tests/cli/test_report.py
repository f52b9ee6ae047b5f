# SPDX-License-Identifier: Apache-2.0
"""`mtcal report`: the file is written, with what was asked for, and a mistake is said before anything is calculated."""

from pathlib import Path

import pytest

from machine_tool_calibration.cli.main import run

from ..told import Verb


@pytest.fixture(scope="module")
def positioning(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run by ISO 230-2."""
    folder = tmp_path_factory.mktemp("report") / "session"
    assert run(["simulate", "--preset", "iso230_2", str(folder)]) == 0
    return folder


def test_a_report_is_written(positioning: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "tolerances.yaml").write_text("format: mtcal-tolerances/1\ntolerances: {EXX: 20um}\n")
    file, figures = tmp_path / "out" / "report.html", tmp_path / "figures"
    words = ["report", str(positioning), "--no-diagnosis", "--tolerances", str(tmp_path / "tolerances.yaml")]
    assert run([*words, "-o", str(file), "--figures", str(figures), "--language", "de"]) == 0
    text = file.read_text(encoding="utf-8")
    assert '<html lang="de">' in text and "Konformität" in text and "Diagnose" not in text
    assert (figures / "iso230_2_X.svg").read_text(encoding="utf-8").lstrip().startswith("<?xml")
    assert f"wrote {file}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["-o", "report.docx"], "a report is an .html or a .pdf file"),
        (["--language", "fr"], "there is no language 'fr'"),
        (["--language", "../en"], "there is no language '../en'"),
        (["--from-history"], "no model was tried yet"),
        (["--budget", "none.yaml"], "none.yaml"),
    ],
)
def test_a_mistake_is_said_in_one_line(positioning: Path, verb: Verb, words: list[str], message: str) -> None:
    said = verb("report", positioning, *words, status=1).err.strip()
    assert message in said and "\n" not in said
