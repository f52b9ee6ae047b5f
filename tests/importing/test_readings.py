# SPDX-License-Identifier: Apache-2.0
"""Readings of any method from a table with names and units of its own."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.importing.build import import_table
from machine_tool_calibration.importing.mapping import ROLES, Mapping, parse_mapping
from machine_tool_calibration.importing.text_table import FileForm
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.units import UNITS as KNOWN_UNITS

DATA = Path(__file__).parents[1] / "data"
UNITS = {"length": "mm", "angle": "deg", "pressure": "hPa"}


def as_people_have_it(session: Path, file: Path) -> None:
    """The readings with lengths in mm, angles in degrees, the reading in micrometres, runs from 1, decimal commas."""
    readings = pd.read_csv(session / "observations.csv")
    table = {}
    for name, values in readings.items():
        if name in ("x", "y", "z"):
            table[f"{name} [mm]"] = (1e3 * values).round(12)
        elif name in ("c", "azimuth", "elevation"):
            table[f"{name} (deg)"] = np.degrees(values).round(12)
        elif name == "displacement":
            table["Reading [um]"] = (1e6 * values).round(10)
        elif name == "air_pressure":
            table[name] = (1e-2 * values).round(12)
        else:
            table[str(name)] = values + 1 if name == "repeat" else values
    pd.DataFrame(table).to_csv(file, sep=";", decimal=",", index=False)


@pytest.mark.parametrize("method", ["step_diagonal", "probing_cross", "rotary_axis", "tracking_2d"])
def test_every_method(method: str, tmp_path: Path) -> None:
    as_people_have_it(DATA / method, tmp_path / "table.csv")
    words = ["convert", str(tmp_path / "table.csv"), str(tmp_path / "made"), "--table", "readings"]
    words += ["--description", str(DATA / method / "session.yaml")]
    assert run([*words, "--column", "displacement=Reading [um]", "--unit", "pressure=hPa"]) == 0
    made, given = read_session(tmp_path / "made"), read_session(DATA / method)
    assert made.description == given.description
    assert np.array_equal(made.readings.setup, given.readings.setup)
    assert np.array_equal(made.readings.repeat, given.readings.repeat)
    np.testing.assert_allclose(made.readings.displacement, given.readings.displacement, rtol=0, atol=1e-15)
    assert made.readings.columns.keys() == given.readings.columns.keys()
    for name, values in given.readings.columns.items():
        np.testing.assert_allclose(made.readings.columns[name], values, rtol=1e-12, atol=1e-14)
    assert {name: list(values) for name, values in made.readings.labels.items()} == {
        name: list(values) for name, values in given.readings.labels.items()
    }


@pytest.mark.parametrize(
    ("without", "units", "message"),
    [
        ("session", UNITS, "a table of readings needs the session.yaml that says of what"),
        ("Reading [um]", UNITS, "no column is named for displacement"),
        ("setup", UNITS, "no column says which of the setups ppp, npp, pnp"),
        ("", {}, "the unit of air_pressure .* is not given, as in --unit air_pressure=hPa or --unit pressure=hPa"),
    ],
)
def test_what_is_lacking_is_said(without: str, units: dict[str, str], message: str, tmp_path: Path) -> None:
    as_people_have_it(DATA / "step_diagonal", tmp_path / "table.csv")
    lines = pd.read_csv(tmp_path / "table.csv", sep=";", dtype=str)
    lines.drop(columns=without, errors="ignore").to_csv(tmp_path / "table.csv", sep=";", index=False)
    described = yaml.safe_load((DATA / "step_diagonal" / "session.yaml").read_text())
    described.pop("format")
    content = {
        "table": "readings",
        "file": {"separator": "semicolon", "decimal": ","},
        "columns": {} if without == "Reading [um]" else {"displacement": "Reading [um]"},
        "units": units,
        "session": {} if without == "session" else described,
    }
    with pytest.raises(SessionError, match=message):
        import_table(tmp_path / "table.csv", parse_mapping(content, "mapping"))


def test_the_setups_of_deviations_need_no_list(tmp_path: Path) -> None:
    """Sixty runs of an axis: the table names them."""
    rows = [f"run {k};{10 * j};{k + j}" for k in range(60) for j in range(3)]
    (tmp_path / "table.csv").write_text("\n".join(["line;x;deviation", *rows, ""]))
    content = {
        "table": "readings",
        "columns": {"setup": "line", "displacement": "deviation"},
        "units": {"x": "mm", "displacement": "um"},
        "values": {"gx": "1", "gy": "0", "gz": "0"},
        "session": {"method": "direct", "machine": {"chain": "w-X-b-t"}, "standard_uncertainty": "1um"},
    }
    imported = import_table(tmp_path / "table.csv", parse_mapping(content, "mapping"))
    assert imported.session.setup_ids == tuple(f"run {k}" for k in range(60))
    assert imported.session.readings.setup.tolist() == np.repeat(np.arange(60), 3).tolist()


def test_a_mapping_and_a_description_that_differ_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    as_people_have_it(DATA / "step_diagonal", tmp_path / "table.csv")
    mapping = {"format": "mtcal-mapping/1", "table": "readings", "session": {"repeats": 1, "blocks": 6}}
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(mapping))
    words = ["convert", str(tmp_path / "table.csv"), str(tmp_path / "made"), "--mapping", str(tmp_path / "m.yaml")]
    assert run([*words, "--description", str(DATA / "step_diagonal" / "session.yaml")]) == 1
    assert "m.yaml: session says blocks, repeats otherwise than --description" in capsys.readouterr().err


def test_the_page_of_mappings_has_every_key() -> None:
    page = (DATA.parents[1] / "docs" / "mappings.md").read_text()
    for name in {
        *Mapping.model_fields,
        *FileForm.model_fields,
        *KNOWN_UNITS,
        *(q for kind in ROLES.values() for q in kind),
    }:
        assert f"`{name}`" in page


def written(file: Path, head: str, *rows: str) -> Path:
    file.write_text("\n".join([head, *rows]) + "\n")
    return file


def positions(file: Path, **more: object) -> tuple[list[float], tuple[str, ...]]:
    """Where a run by ISO 230-2 was read, and what is said of the table."""
    session = {"machine": {"chain": "w-X-b-t"}, "standard_uncertainty": "0.3um"}
    content = {"table": "iso230-2", "axis": "x", "columns": {"position": "Position"}, "session": session, **more}
    content = {"units": {"length": "mm", "deviation": "um"}, **content}
    found = import_table(file, parse_mapping(content, "mapping"))
    return found.session.readings.column("x").tolist(), found.notes


def test_the_origin_of_a_run_shifts_it_and_that_of_another_axis_is_refused(tmp_path: Path) -> None:
    rows = [f"{10 * k},{k},{k + 1}" for k in range(5)]
    file = written(tmp_path / "run.csv", "Position,1 up,1 down", *rows)
    plain = np.array(positions(file)[0])
    np.testing.assert_allclose(positions(file, origin={"x": "250mm"})[0], plain + 0.25)
    with pytest.raises(SessionError, match="origin names y, of which there is no column"):
        positions(file, origin={"y": "250mm"})


@pytest.mark.parametrize(
    ("table", "option"),
    [("iso230-2", {"align": True}), ("points", {"axis": "x"}), ("readings", {"sign": "nominal-minus-actual"}),
     ("readings", {"origin": {"x": "1mm"}}), ("circles", {"targets": {"T": "0, 0, 0 mm"}})],
)  # fmt: skip
def test_an_option_of_another_kind_of_table_is_refused(table: str, option: dict[str, object]) -> None:
    (name,) = option
    with pytest.raises(SessionError, match=f"mapping: a table of {table} has no {name}"):
        parse_mapping({"table": table, **option}, "mapping")


def test_units_in_a_header_are_known_or_refused(tmp_path: Path) -> None:
    rows = [f"{10 * k},{k},{k + 1}" for k in range(5)]
    known = written(tmp_path / "cm.csv", "Position [cm],1 up [µin],1 down [µin]", *rows)
    columns = {"position": "Position [cm]"}
    said = {"units": {"length": "mm"}, "columns": columns}
    assert max(positions(known, **said)[0]) == pytest.approx(0.4)
    unknown = written(tmp_path / "ell.csv", "Position [ell],1 up,1 down", *rows)
    with pytest.raises(SessionError, match=r"'Position \[ell\]' says ell, which is no unit that is known"):
        positions(unknown, columns={"position": "Position [ell]"})
    assert max(positions(unknown, columns={"position": {"column": "Position [ell]", "unit": "mm"}})[0]) == 0.04


def test_rows_that_are_sorted_by_their_time_and_columns_that_are_not_read_are_said(tmp_path: Path) -> None:
    times = [f"2024-10-27 02:{minute:02d}:00" for minute in (40, 45, 50, 55, 0, 5, 10, 15)]
    rows = [f"{10 * k},{k},up,1,{time},dry" for k, time in enumerate(times)]
    file = written(tmp_path / "summer.csv", "Position,Dev,way,run,T,Weather", *rows)
    columns = {"position": "Position", "deviation": "Dev", "direction": "way", "run": "run", "time": "T"}
    _, notes = positions(file, columns=columns, layout="long")
    assert any("line 6: earlier than the row before (1 such rows)" in note for note in notes)
    assert f"{file}: not read: 'Weather'" in notes


def test_names_of_quantities_are_taken_in_capitals_and_two_of_one_are_refused(tmp_path: Path) -> None:
    as_people_have_it(DATA / "tracking_2d", tmp_path / "table.csv")
    text = (tmp_path / "table.csv").read_text()
    head, _, rest = text.partition("\n")
    (tmp_path / "table.csv").write_text(f"{head.upper().replace('[MM]', '[mm]').replace('(DEG)', '(deg)')}\n{rest}")
    content = {
        "table": "readings",
        "units": UNITS,
        "session": yaml.safe_load((DATA / "tracking_2d/session.yaml").read_text()),
    }
    content["columns"] = {"displacement": {"column": "READING [UM]", "unit": "um"}}
    read = import_table(tmp_path / "table.csv", parse_mapping(content, "mapping")).session.readings
    assert read.columns.keys() == read_session(DATA / "tracking_2d").readings.columns.keys()
    (tmp_path / "two.csv").write_text(text.replace("x [mm]", "y", 1))
    with pytest.raises(SessionError, match=r"y may be 'y' and 'y \[mm\]'; say which"):
        import_table(tmp_path / "two.csv", parse_mapping(content, "mapping"))
