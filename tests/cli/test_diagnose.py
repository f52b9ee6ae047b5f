# SPDX-License-Identifier: Apache-2.0
"""`mtcal diagnose` as it is called."""

from pathlib import Path

import pytest

from ..told import Verb

pytestmark = pytest.mark.usefixtures("found_once")


def test_people_read_the_verdict_first(original: Path, verb: Verb) -> None:
    out = verb("diagnose", original).out
    assert out.splitlines()[0] == "The model lacks backlash of Y (backlash_y)."
    assert len(out.splitlines()) <= 24  # one screen: the verdict, the effects, the next step
    assert "b = 1.5" in out and "Next: `mtcal improve` adds backlash_y" in out
    out = verb("diagnose", original, "--details").out
    assert out.splitlines()[0] == "The model lacks backlash of Y (backlash_y)."
    for title in (
        "Effects looked for",
        "Confounded effects",
        "Smallest size",
        "not looked for",
        "the map holds already",
        "taken for",
    ):
        assert title in out
    assert max(map(len, out.splitlines())) <= 120
    assert "\x1b" not in out


def test_pictures_and_numbers_on_request(original: Path, tmp_path: Path, verb: Verb) -> None:
    folder = tmp_path / "new" / "pictures"
    assert "wrote" in verb("diagnose", original, "-o", folder).err
    assert (folder / "diagnosis.png").read_bytes().startswith(b"\x89PNG")
    lines = (folder / "candidates.csv").read_text().splitlines()
    lines = [line for line in lines if not line.startswith("#")]
    assert lines[0].startswith("effect,probability,p_value,delta_bic")
    assert lines[1].startswith("backlash_y,")
