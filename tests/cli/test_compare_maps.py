# SPDX-License-Identifier: Apache-2.0
"""`mtcal compare-maps` with effects and a history: a corrected map can be compared."""

from collections.abc import Iterator

import numpy as np
import pytest

from machine_tool_calibration.methods.map_comparison import compare_fits
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import PRESETS, FlawSpec, SimulationSpec, simulate

from ..told import Verb


@pytest.fixture(scope="module", autouse=True)
def fewer_draws() -> Iterator[None]:
    """Enough for the directions in which these maps can differ."""
    assert compare_fits.__kwdefaults__ is not None
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(compare_fits.__kwdefaults__, "draws", 160)
        yield


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """One machine measured with a backlash of Y, and by another instrument after it was taken out."""
    folder = tmp_path_factory.mktemp("maps")
    plan = PRESETS["tracking_2d"]
    effects = (FlawSpec(id="backlash_y", size=4e-6),)
    for name, spec in (
        ("before", SimulationSpec(plan=plan, seed=3, effects=effects)),
        ("after", SimulationSpec(plan=plan, seed=3)),
    ):
        write_session(simulate(spec).session, folder / name)
    return str(folder / "before"), str(folder / "after")


def test_an_effect_in_the_model_takes_its_part_out_of_the_difference(pair: tuple[str, str], verb: Verb) -> None:
    found = []
    for more in ([], ["--effect", "backlash_y"]):
        found.append(verb("compare-maps", *pair, "--json", *more).document)
    assert "backlash_y" in found[1]["provenance"][0]["effects"]
    raw, corrected = (float(np.nanstd(np.array(one["difference"], dtype=float))) for one in found)
    assert corrected < 0.5 * raw and found[1]["agree"]


def test_the_history_of_one_is_taken_and_the_other_named(pair: tuple[str, str], verb: Verb) -> None:
    assert "no model was tried yet" in verb.refused("compare-maps", *pair, "--from-history")
    verb("improve", pair[0])
    shown = verb("compare-maps", *pair, "--from-history", "--json")
    assert shown.document["provenance"][0]["effects"] == ["backlash_y"]
    assert f"{pair[1]}: no model was tried yet; its method's own is compared" in shown.err


def test_an_effect_that_neither_can_have_is_refused(pair: tuple[str, str], verb: Verb) -> None:
    said = verb.refused("compare-maps", *pair, "--effect", "backlash_c")
    assert "neither measurement can have the effect backlash_c" in said
