# SPDX-License-Identifier: Apache-2.0
"""Sessions are found below a folder, and each is worked out as if it were the only one."""

import json
from functools import partial
from pathlib import Path
from shutil import copytree

import numpy as np
import pandas as pd
import pytest

from machine_tool_calibration.cli.diagnosing import Wanted
from machine_tool_calibration.cli.many import fit_one
from machine_tool_calibration.errors import CalibrationError, SessionError
from machine_tool_calibration.fleet.each import each
from machine_tool_calibration.fleet.parquet import identified_tables, write_tables
from machine_tool_calibration.fleet.sessions import Place, evaluated, identified, is_known, places
from machine_tool_calibration.interface.identification import identify
from machine_tool_calibration.reports.result_tables import tidy
from machine_tool_calibration.session.folder import read_session
from machine_tool_calibration.session.provenance import data_hash

LABELS = ["lathe/2026-01-05", "mill/2026-01-06", "mill/x"]
FIT = partial(fit_one, wanted=Wanted((), (), "rigid_body", ()))


def test_sessions_are_found_in_and_below_folders(measurements: Path, tmp_path: Path) -> None:
    assert [one.label for one in places([measurements])] == LABELS
    (alone,) = places([measurements / "mill/x"])
    assert alone.label == "x"
    assert [one.label for one in places([measurements, measurements / "mill"])] == LABELS
    assert [one.label for one in places([measurements / "mill", measurements / "lathe"])] == LABELS
    assert alone.told(f"{alone.path}/observations.csv: broken") == "observations.csv: broken"
    with pytest.raises(SessionError, match="no session"):
        places([tmp_path])
    with pytest.raises(SessionError, match="no such folder"):
        places([tmp_path / "nowhere"])


def test_each_is_identified_as_it_is_alone_with_dask_and_without(measurements: Path, tmp_path: Path) -> None:
    """In the variant of the model that is wanted; the one that is broken has its line."""
    pytest.importorskip("distributed")
    tables = []
    for workers in (0, 2):
        done = list(each(partial(identified, fit=FIT), places([measurements]), workers=workers))
        tables.append(identified_tables(done))
    for name in ("sessions", "values"):
        pd.testing.assert_frame_equal(tables[0][name], tables[1][name], check_exact=True)
    sessions, values = tables[0]["sessions"].set_index("session"), tables[0]["values"]
    assert [bool(problem) for problem in sessions["problem"]] == [False, False, True]
    assert "observations.csv" in sessions["problem"][LABELS[2]]
    assert list(sessions["model"])[:2] == ["rigid_body", "rigid_body"]
    alone = tidy(identify(measurements / LABELS[1], model="rigid_body").result)
    own = values[values["session"] == LABELS[1]].reset_index(drop=True)[list(alone)]
    np.testing.assert_array_equal(own["value"], alone["value"])
    write_tables(tables[1], tmp_path)
    duckdb = pytest.importorskip("duckdb")
    count = f"SELECT count(*) FROM '{tmp_path}/values.parquet' WHERE session = '{LABELS[1]}' AND u > 0"
    assert duckdb.sql(count).fetchall() == [(int((alone["u"] > 0).sum()),)]
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "values.parquet"), values, check_dtype=False)


def test_folders_say_machine_and_date_where_the_session_does_not(measurements: Path, tmp_path: Path) -> None:
    place = places([measurements])[0]
    found = evaluated(place, FIT)
    assert (found.entry.machine, found.entry.date, found.entry.label) == ("lathe", "2026-01-05", LABELS[0])
    assert {"EXX", "B_mean_X", "volumetric"} <= {size.name for size in found.entry.sizes}
    assert json.loads(json.dumps(found.diagnosis))["verdict"] == "adequate"
    copytree(place.path, tmp_path / "january")
    with pytest.raises(CalibrationError, match="nothing says which machine"):
        evaluated(Place("january", tmp_path / "january"), FIT)


def test_a_session_is_known_however_its_table_is_laid_out(measurements: Path, tmp_path: Path) -> None:
    place = places([measurements])[0]
    known = frozenset({data_hash(read_session(place.path))})
    assert is_known(place, known) and not is_known(place, frozenset({"0"}))
    copytree(place.path, tmp_path / "again")
    table = tmp_path / "again/observations.csv"
    table.write_text(table.read_text(encoding="utf-8").replace(",", " , "), encoding="utf-8")
    assert is_known(Place("again", tmp_path / "again"), known)
    assert not is_known(places([measurements])[2], known)
