# SPDX-License-Identifier: Apache-2.0
"""Every defect gives one line that names the file and the row, line or key."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from machine_tool_calibration.budget.contributor import read_budget
from machine_tool_calibration.effects.formula import read_effects
from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.importing.text_table import FileForm
from machine_tool_calibration.reports.history import read_history
from machine_tool_calibration.session.contributor import Contributor
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.record import validated
from machine_tool_calibration.simulation.machine_file import read_machine
from machine_tool_calibration.simulation.site import read_site
from machine_tool_calibration.simulation.spec import read_spec, spec_from

from .. import plates

Y, C = "session.yaml", "observations.csv"


DEFECTS = yaml.safe_load((Path(__file__).parent / "defects.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("defect", DEFECTS[Y], ids=lambda defect: defect["stands"])
def test_description(session_folder, defect: dict[str, str]) -> None:
    folder = session_folder(defect["of"])
    folder.edit_yaml(defect["instead_of"], defect["stands"])
    assert folder.refusal() == defect["says"]


@pytest.mark.parametrize("defect", DEFECTS[C], ids=lambda defect: f"{defect['column']} {defect['stands']}")
def test_field(session_folder, defect: dict[str, Any]) -> None:
    folder = session_folder(defect["of"])
    folder.set_field(defect["row"], defect["column"], defect["stands"])
    assert folder.refusal() == defect["says"]


@pytest.mark.parametrize(
    ("name", "column"),
    [
        *[("tracking_2d", column) for column in ("setup", "repeat", "x", "y", "azimuth", "displacement")],
        *[("rotary_axis", column) for column in ("target", "c")],
        *[("probing_cross", column) for column in ("point", "x", "y", "c")],
        *[("step_diagonal", column) for column in ("x", "y", "z", "displacement")],
        *[("direct", column) for column in ("setup", "gx", "gy", "gz", "displacement")],
    ],
)
def test_missing_column(session_folder, name: str, column: str) -> None:
    folder = session_folder(name)
    folder.drop_column(column)
    text = folder.refusal()
    assert text.startswith(f"observations.csv: the column '{column}' is missing, which ")


def test_all_missing_columns_are_named(session_folder) -> None:
    folder = session_folder("tracking_2d")
    for column in ("x", "displacement"):
        folder.drop_column(column)
    words = "the columns 'x', 'displacement' are missing, which tracking_interferometer needs"
    assert folder.refusal() == f"observations.csv: {words}"


def test_direct_needs_an_axis(session_folder) -> None:
    folder = session_folder("direct")
    folder.drop_column("x")
    assert folder.refusal() == "observations.csv: no column of an axis position (x, y, z or c), which direct needs"


def test_a_column_of_nearly_the_same_name_is_pointed_at(session_folder) -> None:
    folder = session_folder("tracking_2d")
    lines = folder.lines()
    folder.write_lines([lines[0].replace("displacement", "displacment"), *lines[1:]])
    assert folder.refusal() == (
        "observations.csv: the column 'displacement' is missing, which tracking_interferometer needs "
        "(it has 'displacment')"
    )


FILE_DEFECTS: list[tuple[str, Callable[[bytes], bytes], str]] = [
    (C, lambda _: b"", "observations.csv: the file is empty"),
    (C, lambda _: b"\n\n", "observations.csv: the file is empty"),
    (C, lambda data: data[: data.index(b"\n") + 1], "observations.csv: has a header but no rows"),
    (
        C,
        lambda data: data.decode().encode("utf-16"),
        "observations.csv: the text is UTF-16; save the file as UTF-8; `mtcal convert FOLDER NEW --encoding utf-16` "
        "reads it",
    ),
    (
        C,
        lambda data: data.replace(b"A,0", b"\xb5,0", 1),
        "observations.csv line 2: byte 0xb5 is not UTF-8; save the file as UTF-8",
    ),
    (
        C,
        lambda data: data.replace(b"4.0,A", b"4.0,\0", 1),
        "observations.csv line 3: NUL byte; the file is not text or is damaged",
    ),
    (
        C,
        lambda data: data.replace(b",", b";"),
        "observations.csv line 1: separated by semicolons, not commas; `mtcal convert FOLDER NEW --separator "
        "semicolon` reads it",
    ),
    (
        C,
        lambda data: data.replace(b",", b"\t"),
        "observations.csv line 1: separated by tabs, not commas; `mtcal convert FOLDER NEW --separator tab` reads it",
    ),
    (
        C,
        lambda data: data.replace(b"\n", b"\r"),
        "observations.csv line 1: a bare carriage return; end lines with a line feed",
    ),
    (C, lambda data: data.replace(b",x,", b",time,", 1), "observations.csv line 1: column 'time' stands twice"),
    (
        C,
        lambda data: data.split(b"\n", 1)[1],
        "observations.csv line 1: numbers where the names of the columns should stand: is the header missing?",
    ),
    (C, lambda data: data.replace(b",x,", b",,", 1), "observations.csv line 1: column 4 has no name"),
    (
        C,
        lambda data: data.replace(b"4.0,A", b"4,0,A", 1),
        "observations.csv row 1 (line 3): 20 fields where the header has 19",
    ),
    (C, lambda data: data[:-40], "observations.csv row 287 (line 289): 17 fields where the header has 19"),
    (
        C,
        lambda data: data.replace(b"4.0,A", b'4.0,"A', 1),
        "observations.csv row 1 (line 3): a quote that is not closed",
    ),
    (Y, lambda _: b"", "session.yaml: the file is empty"),
    (Y, lambda _: b"# nothing\n", "session.yaml: the file is empty"),
    (Y, lambda _: b"[1, 2]", "session.yaml: must be a mapping of keys, not a list"),
    (
        Y,
        lambda data: data.replace(b"method: tracking_interferometer\n", b""),
        "session.yaml: the key 'method' is missing",
    ),
    (Y, lambda data: data.decode().encode("utf-16"), "session.yaml: the text is UTF-16; save the file as UTF-8"),
    (
        Y,
        lambda data: data.replace(b"id: A", b"id: \xb5"),
        "session.yaml line 13: byte 0xb5 is not UTF-8; save the file as UTF-8",
    ),
    (
        Y,
        lambda data: data.replace(b"id: A", b"id: \0"),
        "session.yaml line 13: NUL byte; the file is not text or is damaged",
    ),
    (Y, lambda data: data + b"---\na: 1\n", "session.yaml line 26: a second document; one is expected"),
]


@pytest.mark.parametrize(("file", "change", "expected"), FILE_DEFECTS)
def test_file(session_folder, file: str, change: Callable[[bytes], bytes], expected: str) -> None:
    folder = session_folder("tracking_2d")
    path = folder.path / file
    path.write_bytes(change(path.read_bytes()))
    assert folder.refusal() == expected


def test_no_folder_and_no_file(session_folder, tmp_path: Path) -> None:
    with pytest.raises(SessionError, match=rf"^{tmp_path}/nowhere: no such file or folder$"):
        read_session(tmp_path / "nowhere")
    folder = session_folder("direct")
    folder.observed.unlink()
    assert folder.refusal() == f"{folder.path}: no observations.csv in this folder; a session needs it"
    folder.described.unlink()
    assert folder.refusal() == f"{folder.path}: no session.yaml in this folder; a session needs it"
    folder.described.mkdir()
    folder.observed.write_text("a,b\n1,2\n")
    assert folder.refusal() == "session.yaml: is not a file"


def test_blank_lines_do_not_shift_the_line_that_is_named(session_folder) -> None:
    folder = session_folder("tracking_2d")
    folder.set_field(5, "x", "abc")
    lines = folder.lines()
    folder.write_lines(["", *lines[:3], "", "", *lines[3:]])
    assert folder.refusal() == "observations.csv row 5 (line 10): x is 'abc', not a number"


def test_a_measured_column_with_one_word_is_not_taken_for_text(session_folder) -> None:
    folder = session_folder("tracking_2d")
    lines = folder.lines()
    folder.write_lines([lines[0] + ",load", *[f"{line},{i}" for i, line in enumerate(lines[1:])]])
    folder.set_field(11, "load", "12 N")
    assert folder.refusal() == "observations.csv row 11 (line 13): load is '12 N', not a number"


EFFECT = "effects:\n- {{id: creep, enters: reading, formula: r * time, coefficients: {{r: {{unit: m/s, {} 1e-9}}}}}}\n"


@pytest.mark.parametrize(
    ("read", "text", "said"),
    [
        (read_effects, EFFECT.format("low: many, high:"), "low must be a finite number, not 'many'"),
        (read_effects, EFFECT.format("low: -1e-9, hihg:"), "(did you mean 'high'?)"),
        (read_spec, "plan: {method: direct}\nnoise: -1\n", "line 2: noise must be greater than 0, not -1"),
        (read_spec, "plan: {method: direct}\nnoize: 1e-7\n", "line 2: unknown key 'noize' (did you mean 'noise'?)"),
        (read_spec, "plan: {method: direct}\ndirect: 1\n", "line 2: unknown key 'direct'"),
        (read_spec, "plan:\n  method: probing\n  form: -1\n", "line 3: plan.form must be at least 0"),
        (read_machine, "probing: 1\n", "line 1: unknown key 'probing'"),
        (read_machine, "# random: null\n", ": the file is empty"),
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
        validated(FileForm, {"skip": -1}, "")


@pytest.mark.parametrize(
    ("size", "u"),
    [
        ({"standard_uncertainty": 2e-6}, 2e-6),
        ({"expanded": 4e-6, "coverage_factor": 2}, 2e-6),
        ({"half_width": 3e-6, "distribution": "rectangular"}, 3e-6 / 3**0.5),
        ({"half_width": 3e-6}, "a normal distribution has no ends"),
        ({"expanded": 4e-6}, "belong together"),
        ({"standard_uncertainty": 1e-6, "half_width": 1e-6}, "not standard_uncertainty and half_width"),
    ],
)
def test_a_contributor_has_one_size(size: dict[str, Any], u: float | str) -> None:
    content = {"name": "mount", "type": "B", "enters": "reading", "varies": "run", **size}
    if isinstance(u, float):
        assert Contributor.model_validate(content).u == pytest.approx(u)
    else:
        with pytest.raises(ValueError, match=u):
            Contributor.model_validate(content)


def test_an_instrument_reads_along_the_translation_that_is_the_first_term() -> None:
    column = {"x": [0.0], "displacement": [0.0]}
    assert plates.session(column, 1e-6, terms=["EYX", "EXX"]).description.sense == (0.0, 1.0, 0.0)
    for terms in (["EAX"], ["C0Y"], []):
        with pytest.raises(SessionError, match="must begin with a translation"):
            plates.session(column, 1e-6, terms=terms).description.sense  # noqa: B018
