# SPDX-License-Identifier: Apache-2.0
import json

import click
import pytest
from click.testing import CliRunner

from machine_tool_calibration.cli.output import console, json_option, one_line, progress_bar, write_json


def test_json_option_and_document() -> None:
    @click.command()
    @json_option
    def verb(*, as_json: bool) -> None:
        if as_json:
            write_json({"value": float("nan")})

    assert json.loads(CliRunner().invoke(verb, ["--json"]).stdout) == {"value": None}
    assert CliRunner().invoke(verb, []).stdout == ""


def test_text_for_people_is_as_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    console().print("north[a]: 12.5 µm [/a] " + "x" * 90)
    console().print("cell:warning:2")
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert out == "north[a]: 12.5 µm [/a] " + "x" * 90 + "\ncell:warning:2\n", "nothing is put in the place of a name"


def test_one_line() -> None:
    assert one_line("a\n  b\tc\n") == "a b c"


def test_progress_is_on_the_terminal_alone(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for terminal in (False, True):
        if terminal:
            monkeypatch.setenv("FORCE_COLOR", "1")
        with progress_bar() as progress:
            progress("forecasting")
            progress("drawing", 0.5)
        shown = capsys.readouterr()
        assert shown.out == ""
        assert ("drawing" in shown.err) == terminal
