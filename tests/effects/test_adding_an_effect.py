# SPDX-License-Identifier: Apache-2.0
"""The page docs/adding_an_effect.md, executed from top to bottom."""

import json
import re
import shlex
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.effects import catalogue as registry
from machine_tool_calibration.effects.catalogue import catalogue
from machine_tool_calibration.effects.formula import read_effects
from machine_tool_calibration.methods.build import build_model
from machine_tool_calibration.recording.open import open_measurement

PAGE = Path(__file__).parents[2] / "docs" / "adding_an_effect.md"


@dataclass(frozen=True)
class Blocks:
    """The fenced blocks of the page, by language and in order."""

    yaml: list[str]
    python: list[str]
    toml: list[str]
    sh: list[str]


@pytest.fixture(scope="module")
def blocks() -> Blocks:
    found: dict[str, list[str]] = {"yaml": [], "python": [], "toml": [], "sh": []}
    for language, text in re.findall(r"^```(\w+)\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.M | re.S):
        found[language].append(text)
    return Blocks(**found)


@pytest.fixture
def measured(blocks: Blocks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the page's YAML file and the measurement that its first Python block makes."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_effects.yaml").write_text(blocks.yaml[0])
    exec(compile(blocks.python[0], str(PAGE), "exec"), {})
    return tmp_path / "measured"


@pytest.fixture
def plugin(blocks: Blocks, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The page's package, as if it were installed."""
    site = tmp_path / "site"
    announced = tomllib.loads(blocks.toml[0])["project"]
    info = site / f"{announced['name'].replace('-', '_')}-{announced['version']}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Name: {announced['name']}\nVersion: {announced['version']}\n")
    groups = announced["entry-points"].items()
    lines = [f"[{group}]\n" + "\n".join(f"{k} = {v}" for k, v in points.items()) for group, points in groups]
    (info / "entry_points.txt").write_text("\n".join(lines))
    (site / "my_effects.py").write_text(blocks.python[1])
    monkeypatch.syspath_prepend(str(site))
    registry._plugins.cache_clear()
    yield
    registry._plugins.cache_clear()


def commands(block: str) -> list[list[str]]:
    return [shlex.split(line)[1:] for line in block.splitlines()]


def test_the_formula_is_found_added_and_fits(
    blocks: Blocks, measured: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = []
    for words in commands(blocks.sh[0] + blocks.sh[1]):
        assert run(words) == 0
        said.append(" ".join(capsys.readouterr().out.split()))
    page, before, diagnosis, identified, after = said
    assert "e_y = b * dir_y * exp(-time / tau)" in page
    assert {p.name for p in (measured.parent / "pictures").iterdir()} == {"creep_y.png", "README.md"}
    assert "times their declared uncertainty" in before
    assert re.match(r"The model lacks [^.]* \(creep_y\)\.", diagnosis)
    assert "creep_y.b" in identified
    assert after.startswith("The model fits the readings within their declared uncertainty")

    assert run([*commands(blocks.sh[1])[2], "--json"]) == 0
    parameters = {p["name"]: p for p in json.loads(capsys.readouterr().out)["parameters"]}
    for name, truth in (("creep_y.b", 4e-6), ("creep_y.tau", 1500.0)):
        assert abs(parameters[name]["value"] - truth) < 4 * parameters[name]["standard_uncertainty"]


@pytest.mark.usefixtures("plugin")
def test_the_class_is_found_as_a_plugin_and_says_the_same_as_the_formula(
    blocks: Blocks, measured: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in commands(blocks.sh[2]):
        assert run(words) == 0
        assert "creep_of_y" in capsys.readouterr().out
    observations = build_model(open_measurement(measured))[0].observations
    by_class = catalogue()["creep_of_y"]
    by_formula = read_effects(measured.parent / "my_effects.yaml")[0]
    for tau in (200.0, 3000.0):
        np.testing.assert_allclose(
            by_class.columns(observations, (tau,)), by_formula.columns(observations, (tau,)), rtol=1e-12
        )


def test_the_page_names_the_entry_point_group_and_all_keys(blocks: Blocks) -> None:
    from machine_tool_calibration.effects.formula import _Definition

    assert list(tomllib.loads(blocks.toml[0])["project"]["entry-points"]) == [registry.ENTRY_POINT_GROUP]
    # the folder of the page also holds the measurement and the pictures: setuptools would take these for packages
    assert tomllib.loads(blocks.toml[0])["tool"]["setuptools"]["py-modules"] == ["my_effects"]
    text = PAGE.read_text(encoding="utf-8")
    for key in set(_Definition.model_fields) - {"title", "source"}:
        assert f"`{key}`" in text
