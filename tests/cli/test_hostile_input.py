# SPDX-License-Identifier: Apache-2.0
"""Files and streams that nobody means to give: one line, in bounded time, nothing on standard output.
What a verb cannot do is said in one line, the same for all of them: input with status 1, a command line with 2.
"""

import io
import os
import re
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from machine_tool_calibration.cli.main import run
from machine_tool_calibration.session.folder import write_session
from machine_tool_calibration.simulation import SimulationSpec, simulate
from machine_tool_calibration.simulation.spec import PLANS

from ..told import Verb


@pytest.fixture
def session(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    write_session(simulate(SimulationSpec(plan=PLANS["direct"](), seed=3)).session, folder)
    return folder


VERBS = (
    *(("identify",), ("info",), ("compare",), ("diagnose",), ("history",), ("improve",), ("recover",), ("plan",)),
    *(("play",), ("workpiece", "--spacing", 1), ("export", "--format", "json")),
    *(("convert", "--table", "points", "--dry-run"), ("convert", "--to", "csv")),
)


@pytest.mark.parametrize("words", VERBS, ids=str)
def test_a_link_to_itself(verb: Verb, tmp_path: Path, words: tuple[object, ...]) -> None:
    for name in ("link", "link.mcap", "link.yaml"):
        (tmp_path / name).symlink_to(name)
        target = [tmp_path / "out"] if "--to" in words else []
        verb.refused(words[0], tmp_path / name, *target, *words[1:])


@pytest.mark.parametrize("words", VERBS, ids=str)
def test_a_pipe_without_a_writer(verb: Verb, tmp_path: Path, words: tuple[object, ...]) -> None:
    for name in ("pipe", "pipe.mcap", "pipe.yaml"):
        os.mkfifo(tmp_path / name)
        target = [tmp_path / "out"] if "--to" in words else []
        verb.refused(words[0], tmp_path / name, *target, *words[1:])


@pytest.mark.parametrize("file", ["session.yaml", "observations.csv"])
def test_a_session_of_a_link_to_itself(verb: Verb, session: Path, file: str) -> None:
    (session / file).unlink()
    (session / file).symlink_to(file)
    assert f"no {file} in this folder" in verb.refused("identify", session)


def test_numpy_warns_nobody(verb: Verb, session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def overflows(*_: object) -> None:
        warnings.warn("overflow encountered in square", RuntimeWarning, stacklevel=2)
        _ = np.array([1e308]) * 1e308

    monkeypatch.setattr("machine_tool_calibration.session.checks.check_units", overflows)
    assert verb("info", session, "--json").err == ""


def test_a_terminal_that_lacks_letters(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="ascii"))
    assert run(["info", str(session)]) == 0
    sys.stdout.flush()
    assert b"?m" in written.getvalue()


def test_a_plan_of_repeats_without_end(verb: Verb, tmp_path: Path) -> None:
    procedure = Path(__file__).parents[2] / "config" / "procedures" / "tracking_2d.yaml"
    text = procedure.read_text(encoding="utf-8")
    (tmp_path / "p.yaml").write_text(re.sub(r"repeats: \d+", "repeats: 1000000000", text), encoding="utf-8")
    assert "at most 1000 are planned" in verb.refused("plan", tmp_path / "p.yaml")


def test_a_recording_that_names_a_file_twice(verb: Verb, session: Path, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    verb("convert", session, bag)
    text = (bag / "metadata.yaml").read_text(encoding="utf-8")
    name = "  - bag_0.mcap\n"
    assert name in text
    (bag / "metadata.yaml").write_text(text.replace(name, 5000 * name, 1), encoding="utf-8")
    assert "names a file twice" in verb.refused("info", bag)


@pytest.mark.parametrize(
    "words",
    [
        ["run", "tracking_2d", "--namespace", "5um"],
        ["demo", "--namespace", "a b"],
        ["convert", "session", "bag", "--namespace", "cell//1"],
        ["record", "/"],
        ["record", "--namespace", "/cell-1"],
        ["play", "bag", "--remap", ":="],
        ["play", "bag", "--remap", "/reading:=/cell 2/reading"],
        ["budget", "session", "--draws", "1000000000"],
        ["plan", "tracking_2d", "--warming", "nan"],
        ["conformity", "session", "--tolerance", "EXX=10um", "--probability", "nan"],
        ["play", "bag", "--rate", "inf"],
    ],
)
def test_names_that_ros_has_not_and_numbers_that_are_none_are_refused_before_anything_begins(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: Verb
) -> None:
    monkeypatch.chdir(tmp_path)
    said = verb(*words, status=2)
    assert not said.out
    assert words[-1] in said.err.replace("--remap ", "")
    assert not list(tmp_path.iterdir())


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
        (["features", CROSS, "--through", "sphere*"], 2, "'sphere*' is not of the form NAME=A,B,…"),
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
