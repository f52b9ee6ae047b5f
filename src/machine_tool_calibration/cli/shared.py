# SPDX-License-Identifier: Apache-2.0
"""What every verb of `mtcal` shares: JSON for programs, text for people, one line for an error.

A verb prints for people through `console()`; with `--json` it writes one document with `write_json` and nothing else to
standard output. Progress and notes go to standard error (`console(stderr=True)`, `note`). A wrong input raises a
`CalibrationError`, which `mtcal` turns into one line and exit status 1.
"""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.files import save
from machine_tool_calibration.reports.documents import to_json
from machine_tool_calibration.reports.tables import Part, show

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from machine_tool_calibration.interface.show import Answer
    from machine_tool_calibration.session.provenance import Provenance

Command = TypeVar("Command", bound=Callable[..., Any])
Progress = Callable[[str, float | None], None]
"""Is told what is being done, and which share of it is done, from 0 to 1; None where that is not known."""


def options(*several: Callable[[Any], Any]) -> Callable[[Command], Command]:
    """Several options as one decorator of a verb; `--help` lists them in this order."""

    def add(function: Command) -> Command:
        for option in reversed(several):
            function = option(function)
        return function

    return add


PATH = click.Path(path_type=Path)
FILE, FOLDER = click.Path(path_type=Path, dir_okay=False), click.Path(path_type=Path, file_okay=False)

seed_option = click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of random draws.")
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Write one JSON document to standard output, for programs."
)


class Number(click.FloatRange):
    """A finite number within bounds: no comparison refuses NaN."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number; anything else is refused before anything begins."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number.", param, ctx)
        return number


class PictureFile(click.Path):
    """A picture that is to be drawn; a name without an ending is one in PNG, or a folder for a picture `in_folder`."""

    ENDINGS = ("eps", "jpeg", "jpg", "pdf", "pgf", "png", "ps", "svg", "svgz", "tif", "tiff", "webp")

    def __init__(self, in_folder: str = "") -> None:
        super().__init__(path_type=Path, dir_okay=bool(in_folder))
        self.in_folder = in_folder

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The path; what cannot be drawn is refused before anything is calculated."""
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        ending = path.suffix.removeprefix(".").lower()
        if ending and ending not in self.ENDINGS and not path.is_dir():
            self.fail(f"{path}: no picture can be written as {path.suffix}; as {', '.join(self.ENDINGS)}", param, ctx)
        return path / self.in_folder if self.in_folder and (not ending or path.is_dir()) else path


class RosName(click.ParamType):  # type: ignore[type-arg]
    """The name of a topic, or a namespace, as ROS accepts it; empty where none is given."""

    name = "name"
    FORM = re.compile(r"(~?/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")

    def __init__(self, *, space: bool = False) -> None:
        """Of a topic, or where `space` is true of a namespace, which may also be the root or end in a slash."""
        self.space = space

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The name as it is."""
        name = value.strip("/") if self.space else value
        if not self.FORM.fullmatch(name) and not (self.space and not name):
            self.fail(f"{value!r} is no name in ROS: letters, digits and _ between /, no digit first", param, ctx)
        return value


class Pair(click.ParamType):  # type: ignore[type-arg]
    """A name and what stands for it, with `=` between them."""

    name = "pair"

    def __init__(self, form: str = "NAME=…") -> None:
        self.form = form

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Both, without blanks around them."""
        name, _, said = map(str.strip, value.partition("="))
        if not name or not said:
            self.fail(f"{value!r} is not of the form {self.form}", param, ctx)
        return name, said


def session_labels(paths: Sequence[Path]) -> list[str]:
    """Names of several sessions: those of their folders, numbered where they repeat."""
    from machine_tool_calibration.session.session import distinct_labels, measurement_name

    return distinct_labels([measurement_name(path) for path in paths])


def write_json(document: Any) -> None:
    """Write one JSON document to standard output."""
    click.echo(to_json(document))


def write_new(file: Path, text: str) -> None:
    """Write a text file; a CalibrationError if it is there already, or cannot be written."""
    if file.exists():
        raise CalibrationError(f"{file}: is there already; choose another file")
    save(file, text)


def save_picture(draw: Callable[[], Figure], file: Path | None, origin: Provenance | None = None) -> None:
    """Draw a picture into a file, where one is named, with what it was made from at its foot."""
    if file is not None:
        from machine_tool_calibration.plots.style import save_as

        save_as(draw(), file, origin)
        note_written([file])


def tell(answer: Answer, as_json: bool, parts: Iterable[Part] | None = None) -> None:
    """Say what was found: the document for programs, or the text for people, in other parts where these are given."""
    if as_json:
        write_json(answer.document())
    else:
        show(console(), answer.parts() if parts is None else parts)


def tell_either(document: Mapping[str, Any], parts: Iterable[Part], as_json: bool) -> None:
    """The same of what is no answer of the interface; parts that nobody reads are not made, if they are an iterator."""
    if as_json:
        write_json(document)
    else:
        show(console(), parts)


def console(*, stderr: bool = False) -> Console:
    """Where text for people goes; plain text when that is not a terminal."""
    from rich.console import Console  # here, because the import costs 0.1 s that `--help` does not need

    class Screen(Console):
        def on_broken_pipe(self) -> None:
            # rich would exit with status 1, as for a wrong input; `mtcal` has a status of its own for a closed pipe.
            raise BrokenPipeError

    stream = sys.stderr if stderr else sys.stdout
    # Tables keep their width in a file or a pipe, where rich would assume 80 columns.
    width = None if stream.isatty() or "COLUMNS" in os.environ else 120
    # What is printed is of people's files: no name in them, such as north[a], is markup.
    return Screen(file=stream, width=width, highlight=False, emoji=False, markup=False)


@contextmanager
def bar(begin: str, *, counted: bool = False) -> Iterator[Callable[..., None] | None]:
    """A progress bar on standard error, of how many of all where they are counted; None where that is no terminal.

    It is told `description`, `completed` and `total`.
    """
    screen = console(stderr=True)
    if not screen.is_terminal:
        yield None
        return
    from rich import progress as rich

    words = rich.TextColumn("{task.description}", markup=False)
    count = [rich.MofNCompleteColumn()] if counted else []
    columns = (rich.SpinnerColumn(), words, rich.BarColumn(), *count, rich.TimeElapsedColumn())
    with rich.Progress(*columns, console=screen, transient=True) as shown:
        yield partial(shown.update, shown.add_task(begin, total=None))


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A progress bar on standard error; nothing where that is not a terminal."""
    with bar("reading") as update:

        def report(what: str, share: float | None = None) -> None:
            if update is not None:
                update(description=what, total=None if share is None else 1.0, completed=share or 0.0)

        yield report


def note(text: str) -> None:
    """A remark for people, on standard error."""
    click.echo(text, err=True)


def note_written(paths: Sequence[Path]) -> None:
    """Say on standard error what was written."""
    if paths:
        note(f"wrote {', '.join(str(path) for path in paths)}")
