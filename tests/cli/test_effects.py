# SPDX-License-Identifier: Apache-2.0
"""`mtcal effects`: the catalogue, one effect in full, and what its residuals look like."""

from pathlib import Path

import pytest

from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.reports.effect_page import effects_table

from ..told import Verb

DOCS = Path(__file__).parents[2] / "docs" / "effects"
OWN = """
effects:
  - id: sag
    title: sag of the ram
    enters: x
    formula: k * x^2
    coefficients: {k: {unit: 1/m, low: 0, high: 1.0e-3}}
"""


def test_the_catalogue_is_listed(verb: Verb) -> None:
    out = verb("effects").out
    for name in catalogue():
        assert name in out.split()
    assert f"{len(catalogue())} effects" in out


def test_json_holds_every_effect(verb: Verb) -> None:
    document = verb("effects", "--json").document
    assert document["format"] == "mtcal-effects/1"
    by_id = {entry["id"]: entry for entry in document["effects"]}
    assert list(by_id) == list(catalogue())
    for entry in by_id.values():
        assert entry["formula"] and entry["source"] and entry["title"]
        assert all(c["low"] < c["high"] for c in entry["coefficients"])
    assert by_id["backlash_x"]["columns"] == ["x", "dir_x"] and by_id["backlash_x"]["beside"] == ""
    assert by_id["second_periodic_x"]["beside"] == "pitch_periodic_x"
    assert by_id["warmup_y"]["nonlinear"][0]["name"] == "tau"


@pytest.mark.long
def test_one_effect_in_full_says_what_each_method_leaves(verb: Verb) -> None:
    out = verb("effects", "mirror_misalignment", "backlash_y").out
    first, second = out.split("backlash_y: backlash of Y")
    row = next(line for line in first.splitlines() if line.startswith("step_diagonal "))
    assert row.split()[1] == "0%" and "tilt of the mirror" in row
    assert "not in tracking_2d, tracking_3d: does not occur with tracking interferometer" in " ".join(first.split())
    assert "b (half width): 0 µm to 50.0 µm" in second
    assert "ISO 230-2" in second
    assert "looked for:    beside pitch_periodic_x only" in verb("effects", "second_periodic_x").out


def test_effects_that_differ_by_the_axis_share_a_line() -> None:
    table = effects_table(list(catalogue().values()))
    ids = [row[0].split() for row in table.rows]
    assert sorted(name for group in ids for name in group) == sorted(catalogue())
    assert ["backlash_x", "backlash_y", "backlash_z"] in ids
    assert ["EXX", "EYX", "EZX", "EXY", "EYY", "EZY", "EXZ", "EYZ", "EZZ"] in ids
    assert ["dead_path"] in ids
    formulas = {row[0].split()[0]: row[2] for row in table.rows}
    assert formulas["backlash_x"] == catalogue()["backlash_x"].formula


@pytest.mark.long
def test_effects_of_the_users_own_are_listed_and_drawn(tmp_path: Path, verb: Verb) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(OWN)
    document = verb("effects", "--effects-file", file, "sag", "--gallery", tmp_path / "g", "--json").document
    assert [entry["id"] for entry in document["effects"]] == ["sag"]
    assert (tmp_path / "g" / "sag.png").read_bytes().startswith(b"\x89PNG")
    assert "![residuals of sag](sag.png)" in (tmp_path / "g" / "README.md").read_text()


def test_the_gallery_of_the_documentation_is_whole_and_small() -> None:
    page = (DOCS / "README.md").read_text(encoding="utf-8")
    pictures = sorted(DOCS.glob("*.png"))
    assert len(pictures) >= 18
    for picture in pictures:
        assert f"({picture.name})" in page
        assert picture.stem in catalogue()
        assert picture.stat().st_size < 60_000
