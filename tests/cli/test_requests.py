# SPDX-License-Identifier: Apache-2.0
"""What a verb cannot do is said in one line, the same for all of them: input with status 1, a command line with 2."""

from pathlib import Path

import pytest

from ..told import Verb

DATA = Path(__file__).parents[1] / "data"
PLANE, CROSS, NOTHING = DATA / "tracking_2d", DATA / "probing_cross", DATA / "nothing"


@pytest.mark.parametrize("name", ["identify", "compare", "diagnose", "improve", "budget"])
@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([NOTHING], "nothing: no such file or folder"),
        ([PLANE, NOTHING], "nothing: no such file or folder"),
        ([PLANE, "--effect", "backlash_q"], "unknown effect 'backlash_q'"),
        ([PLANE, "--model", "clay"], "known are free, rigid_body"),
        ([PLANE, "--effects-file", "no/such.yaml"], "no/such.yaml"),
    ],
)
def test_every_verb_of_a_session_refuses_the_same(name: str, words: list[object], message: str, verb: Verb) -> None:
    assert message in verb.refused(name, *words)


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (["identify"], 2, "Missing argument"),
        (["compare", PLANE, "--against", "nonsense"], 1, "there is no covariate 'nonsense'"),
        (["history", NOTHING], 1, "no such file"),
        (["history", PLANE], 1, "no model was tried yet"),
        (["history", PLANE, "--undo", "--use", "1"], 2, "either"),
        (["budget"], 2, "Missing argument 'SESSION'"),
        (["budget", PLANE, "--template", "touch_probe"], 2, "--template is without SESSION"),
        (["budget", "--template", "ruler"], 1, "no budget for the instrument 'ruler'"),
        (["budget", PLANE, "--quantity", "EXX"], 1, "'EXX' is not published of this measurement"),
        (["budget", PLANE, "--budget", "none.yaml"], 1, "none.yaml: no such file"),
        (["budget", PLANE, "--draws", "5"], 2, "5 is not in the range 100<=x<="),
        (["conformity", PLANE], 2, "Missing --tolerance"),
        (["conformity", PLANE, "--tolerance", "EXX=10"], 1, "tolerance of EXX: '10' has no unit"),
        (["conformity", PLANE, "--tolerance", "large=1um"], 1, "'large' is no figure with a tolerance"),
        (["conformity", PLANE, "--tolerance", "EXX=1um", "--rule", "strict"], 2, "'strict' is not one of"),
        (["features", PLANE], 1, "this session is of the method tracking_interferometer"),
        (["features", CROSS, "--distance", "sphere1"], 2, "'sphere1' is not 2 names with commas between them"),
        (["features", CROSS, "--angle", "a,,b"], 2, "'a,,b' is not 2 or 3 names with commas between them"),
        (["features", CROSS, "--through", "sphere*"], 2, "'sphere*' is not NAME=A,B,…"),
        (["plan", "pointer_centre"], 1, "no errors of the machine come out of it"),
    ],
)
def test_a_wrong_request(words: list[object], status: int, message: str, verb: Verb) -> None:
    err = verb(*words, status=status).err
    assert message in err and "Traceback" not in err


@pytest.mark.parametrize("words", [["features", CROSS], ["compare-maps", PLANE, PLANE], ["budget", PLANE]])
def test_a_picture_of_no_known_format_is_refused_at_once(words: list[object], tmp_path: Path, verb: Verb) -> None:
    said = verb(*words, "--plot", tmp_path / "picture.foo", status=2)
    assert not said.out and not list(tmp_path.iterdir())
    assert "picture.foo: no picture can be written as .foo; as " in said.err
