# SPDX-License-Identifier: Apache-2.0
import importlib.metadata
import json
import shutil
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from machine_tool_calibration import __version__, cli
from machine_tool_calibration.cli import main as verbs
from machine_tool_calibration.cli.main import group, run
from machine_tool_calibration.cli.shared import console, json_option, progress_bar, write_json
from machine_tool_calibration.errors import one_line

VERB = '''
"""A module of a verb."""

import click

from machine_tool_calibration.errors import SessionError


@click.command()
@click.option("--number", type=int, default=0)
def command(number: int) -> {returns}:
    """Do what is tested. More words that the list leaves out.

    A second paragraph.
    """
    {body}
'''

Write = Callable[..., None]


@pytest.fixture
def verb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Writes a verb into a folder of verbs of its own."""
    monkeypatch.setattr(cli, "__path__", [str(tmp_path)])
    monkeypatch.setitem(vars(group), "_entry_points", {})  # so that what is cached meanwhile does not stay
    del vars(group)["_entry_points"]

    def write(name: str, body: str = "pass", source: str | None = None) -> None:
        text = VERB.format(body=body, returns="object") if source is None else textwrap.dedent(source)
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
        monkeypatch.delitem(sys.modules, f"{cli.__name__}.{name}", raising=False)

    return write


def one_error_line(capsys: pytest.CaptureFixture[str]) -> str:
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    return captured.err.removesuffix("\n")


@pytest.mark.parametrize("option", ["--version", "-V"])
def test_version(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run([option]) == 0
    assert capsys.readouterr().out == f"mtcal {__version__}\n"


def test_verbs_are_found_and_named_with_dashes(verb: Write, capsys: pytest.CaptureFixture[str]) -> None:
    verb("two_words", "click.echo('done')")
    verb("helper", source="def work(): ...")
    verb("_private")
    assert run(["--help"]) == 0
    text = capsys.readouterr().out
    assert "two-words  Do what is tested\n" in text
    assert "helper" not in text
    assert "private" not in text
    assert run(["two-words"]) == 0
    assert capsys.readouterr().out == "done\n"


def test_known_verbs_stand_under_what_they_are_for(verb: Write, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("identify", "demo", "zzz"):
        verb(name)
    run(["--help"])
    lines = capsys.readouterr().out.splitlines()
    order = [next(i for i, line in enumerate(lines) if line.strip().startswith(word)) for word in
             ("Measure:", "demo  ", "Identify:", "identify  ", "More:", "zzz  ")]  # fmt: skip
    assert order == sorted(order)


def test_a_summary_goes_on_after_et_al(verb: Write, capsys: pytest.CaptureFixture[str]) -> None:
    verb("other", source='"""Find it (A et al. 2014). More."""\nimport click\ncommand = click.Command("other")\n')
    run(["--help"])
    assert "Find it (A et al. 2014)\n" in capsys.readouterr().out


def test_a_verb_may_be_assigned(verb: Write, capsys: pytest.CaptureFixture[str]) -> None:
    verb("other", source='"""What the module says."""\nimport click\ncommand = click.Command("other")\n')
    run(["--help"])
    assert "What the module says" in capsys.readouterr().out


def test_help_imports_no_verb(verb: Write, capsys: pytest.CaptureFixture[str]) -> None:
    verb("bad", source='raise RuntimeError("imported")\ndef command():\n    """A verb."""\n')
    assert run(["--help"]) == 0
    assert "A verb" in capsys.readouterr().out


def test_only_the_verb_that_is_asked_for_is_read(verb: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    verb("good")
    verb("other")
    read = []
    summary = verbs._summary
    monkeypatch.setattr(verbs, "_summary", lambda source: read.append(source.stem) or summary(source))
    assert run(["good"]) == 0
    assert run(["good", "--help"]) == 0
    assert set(read) == {"good"}
    assert run(["--help"]) == 0
    assert set(read) == {"good", "other"}


@pytest.mark.parametrize(
    ("words", "without"),
    [
        (["--help"], ["numpy", "scipy", "pandas", "matplotlib", "pydantic", "rich", "rclpy"]),
        (["effects"], ["scipy", "pandas", "matplotlib", "pydantic", "mcap", "rosbags"]),
        (["history", "session"], ["numpy", "scipy", "pandas", "matplotlib", "mcap", "rosbags"]),
        (["info", "session"], ["scipy", "pandas", "matplotlib", "mcap", "rosbags"]),
    ],
)
def test_what_needs_no_large_library_imports_none(
    words: list[str], without: list[str], original: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "session"
    shutil.copytree(original, folder)
    (folder / "history.yaml").write_text("format: mtcal-history/1\n", encoding="utf-8")
    code = (
        f"import sys; from machine_tool_calibration.cli.main import run; assert run({words!r}) == 0\n"
        f"print(sorted({set(without)!r} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=900, check=True, cwd=tmp_path
    )
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("def command(:", "SyntaxError"),
        ("command = 1", "no click command"),
        ("import no_such_module\ncommand = 1", "No module named 'no_such_module'"),
        ("raise ZeroDivisionError('x')\ncommand = 1", "ZeroDivisionError"),
        ("raise ModuleNotFoundError(name='rclpy.node')\ncommand = 1", "source your ROS 2"),
    ],
)
def test_a_broken_verb_says_so_and_harms_no_other(
    verb: Write, capsys: pytest.CaptureFixture[str], source: str, says: str
) -> None:
    verb("broken", source=source)
    verb("good", "click.echo('done')")
    assert run(["good"]) == 0
    capsys.readouterr()
    assert run(["broken"]) == 1
    line = one_error_line(capsys)
    assert says in line
    assert "`mtcal broken`" in line
    assert run(["--help"]) == 0


def test_wrong_input_is_one_line_and_status_1(verb: Write, capsys: pytest.CaptureFixture[str]) -> None:
    verb("fails", "raise SessionError('a.csv row 3:\\n  no number')")
    assert run(["fails"]) == 1
    assert one_error_line(capsys) == "mtcal: a.csv row 3: no number"


def test_a_mistyped_verb_is_refused_with_a_hint(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["identfy", "session"]) == 2
    assert "No such command 'identfy' (did you mean 'identify'?)" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["nothing"], ["good", "--number", "x"], ["good", "--no"], ["good", "x"], ["--no"]])
def test_a_wrong_command_line_is_status_2(verb: Write, capsys: pytest.CaptureFixture[str], words: list[str]) -> None:
    verb("good")
    assert run(words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Error" in captured.err


@pytest.mark.parametrize(
    ("body", "status", "says"),
    [
        ("open('/no/such/file')", 1, "/no/such/file: No such file or directory"),
        ("raise OSError(28, 'No space left on device')", 1, "No space left"),
        ("raise click.ClickException('not so')", 1, "not so"),
        ("raise MemoryError", 1, "not enough memory"),
        ("raise KeyError('x')", 1, "unexpected KeyError"),
        ("raise ModuleNotFoundError(name='rclpy')", 1, "this needs ROS 2 (rclpy is missing): source your ROS 2"),
        ("raise KeyboardInterrupt", 130, "interrupted"),
    ],
)
def test_no_failure_shows_a_traceback(
    verb: Write, capsys: pytest.CaptureFixture[str], body: str, status: int, says: str
) -> None:
    verb("fails", body)
    assert run(["fails"]) == status
    err = capsys.readouterr().err.strip()
    assert says in err
    assert "\n" not in err


def test_a_message_keeps_a_measure(verb: Write, capsys: pytest.CaptureFixture[str]) -> None:
    verb("fails", "raise SessionError('about ' + 'a' * 5000 + ' and its end')")
    assert run(["fails"]) == 1
    line = one_error_line(capsys)
    assert line.startswith("mtcal: about aaa")
    assert line.endswith(" and its end")
    assert len(line) < 1100


def test_a_traceback_for_developers(verb: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    verb("fails", "raise KeyError('x')")
    monkeypatch.setenv("MTCAL_TRACEBACK", "1")
    with pytest.raises(KeyError):
        run(["fails"])


@pytest.mark.parametrize(
    ("body", "status"),
    [("return None", 0), ("return True", 0), ("return 3", 3), ("click.get_current_context().exit(4)", 4)],
)
def test_exit_status_of_a_verb(verb: Write, body: str, status: int) -> None:
    verb("ends", body)
    assert run(["ends"]) == status


def plugins(monkeypatch: pytest.MonkeyPatch, **values: str) -> None:
    found = [EntryPoint(name, value, verbs.PLUGIN_GROUP) for name, value in values.items()]
    by_group = {verbs.PLUGIN_GROUP: found}
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda *, group: by_group.get(group, []))


def test_plugins(verb: Write, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    verb("good", "click.echo('built in')")
    verb("_extra", "click.echo('plugged in')")
    module = f"{cli.__name__}._extra"
    plugins(monkeypatch, extra=f"{module}:command", bad="no_such_module:command", good=f"{module}:command")
    assert run(["--help"]) == 0
    captured = capsys.readouterr()
    assert "extra  Do what is tested\n" in captured.out
    assert "bad" not in captured.out
    assert captured.err.count("\n") == 1
    assert "plugin 'bad' is skipped" in captured.err
    assert run(["extra"]) == 0
    assert run(["good"]) == 0
    assert capsys.readouterr().out == "plugged in\nbuilt in\n"
    assert run(["bad"]) == 2
    assert "skipped" in capsys.readouterr().err


def start(body: str, folder: Path) -> subprocess.Popen[str]:
    """`mtcal` in a process of its own with a verb `work`."""
    (folder / "work.py").write_text(VERB.format(body=body, returns="None"), encoding="utf-8")
    code = (
        "from machine_tool_calibration import cli; from machine_tool_calibration.cli.main import main; "
        f"cli.__path__.append({str(folder)!r}); main()"
    )
    pipe = subprocess.PIPE
    return subprocess.Popen(
        [sys.executable, "-c", code, "work"],
        stdin=pipe,
        stdout=pipe,
        stderr=pipe,
        text=True,
        # A shell has its background jobs ignore Ctrl-C, and they pass that on.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


@pytest.mark.parametrize("lines", [3, 100_000])
def test_a_reader_that_goes_away_is_no_error(tmp_path: Path, lines: int) -> None:
    body = f"import sys; sys.stderr.write('r'); sys.stderr.flush(); sys.stdin.read(); print('line\\n' * {lines})"
    with start(body, tmp_path) as process:
        assert process.stdin is not None and process.stdout is not None and process.stderr is not None
        assert process.stderr.read(1) == "r"
        process.stdout.close()
        process.stdin.close()
        assert process.stderr.read() == ""
        assert process.wait(900) == 141


def test_without_standard_streams(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a scheduler may start it: what Python then has instead of a stream is None."""
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, None)
    assert run(["effects", "scale"]) == 0
    assert run(["info", "nowhere"]) == 1
    for stream in (sys.stdout, sys.stderr):
        stream.close()


def test_ctrl_c_ends_quietly(tmp_path: Path) -> None:
    with start("import time; print('begun', flush=True); time.sleep(900)", tmp_path) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGINT)
        assert process.stderr.read().strip() == "mtcal: interrupted"
        assert process.wait(900) == 130


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
