# SPDX-License-Identifier: Apache-2.0
"""The page names machines, effects and problems in its language; the tables hold the numbers."""

import re
from collections.abc import Callable
from pathlib import Path

import html5lib
import pandas as pd
import pytest

from machine_tool_calibration.fleet.machines import Machines, judged
from machine_tool_calibration.fleet.page import write_page
from machine_tool_calibration.fleet.parquet import machine_tables, write_tables
from machine_tool_calibration.trends.logbook import Entry
from machine_tool_calibration.words import words

from .test_machines import found, values


@pytest.fixture
def fleet(entries: Callable[..., tuple[Entry, ...]]) -> Machines:
    jumped, lacking = entries("mill <1>", values(2e-6)), entries("lathe", values())
    diagnoses = {one.sha256: found("backlash_x", 1e-6) for one in lacking}
    return judged((*jumped, *lacking), diagnoses, problems=[("mill/x", "no <column>")])


@pytest.mark.long
@pytest.mark.parametrize(("language", "head", "told"), [
    ("en", "Fleet of machines", r"EXX jumped by [12]\.\d+ ± "),
    ("de", "Maschinenpark", r"EXX ist zwischen .* um [12],\d+ ± "),
])  # fmt: skip
def test_the_page(fleet: Machines, tmp_path: Path, language: str, head: str, told: str) -> None:
    text = write_page(fleet, tmp_path / "shop.logbook", tmp_path / "page" / "fleet.html", words(language)).read_text(
        encoding="utf-8"
    )
    html5lib.HTMLParser(strict=True).parse(text)
    assert f"<h1>{head}</h1>" in text and re.search(told, text)
    assert "mill &lt;1&gt;" in text and "no &lt;column&gt;" in text and "backlash_x" in text
    assert text.count("data:image/svg+xml") == 2  # all machines, and what changed on one
    assert re.findall(r'<section id="(\w+)"', text) == ["attention", "effects", "all", "failed", "provenance"]
    assert "mill <1>" not in text


def test_a_page_without_any_machine(tmp_path: Path) -> None:
    text = write_page(judged((), {}), tmp_path / "none", tmp_path / "fleet.html", words("en")).read_text(
        encoding="utf-8"
    )
    assert "No machine yet." in text


@pytest.mark.long
def test_duckdb_and_pandas_read_the_tables(fleet: Machines, tmp_path: Path) -> None:
    duckdb = pytest.importorskip("duckdb")
    written = write_tables(machine_tables(fleet), tmp_path)
    assert [file.stem for file in written] == ["machines", "sessions", "sizes", "trends", "effects"]
    assert not list(tmp_path.glob(".*"))
    changed = f"SELECT machine, name, change FROM '{tmp_path}/trends.parquet' WHERE alarm AND name = 'EXX'"
    ((machine, name, change),) = duckdb.sql(changed).fetchall()
    assert (machine, name) == ("mill <1>", "EXX") and change == pytest.approx(2e-6, abs=2e-7)
    sizes = pd.read_parquet(tmp_path / "sizes.parquet")
    own = sizes[(sizes["machine"] == "lathe") & (sizes["name"] == "EXX")]
    assert list(own["value"]) == values()
    where = f"SELECT machine, avg(value) FROM '{tmp_path}/effects.parquet' GROUP BY machine"
    assert duckdb.sql(where).fetchall() == [("lathe", 1e-6)]
    empty = write_tables(machine_tables(judged((), {})), tmp_path / "none")
    assert duckdb.sql(f"SELECT effect FROM '{empty[-1]}'").fetchall() == []
