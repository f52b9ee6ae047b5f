"""What `mtcal run` and `mtcal demo` share: options, the progress bar, and what is shown at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
import numpy as np

from machine_tool_calibration.cli.output import error_console

if TYPE_CHECKING:
    from rich.console import Console

    from machine_tool_calibration.nodes.measurement import Measured, Progress

__all__ = ["bar", "figures", "graph_options", "show_files", "show_result"]

Command = TypeVar("Command", bound=Callable[..., Any])


def graph_options(function: Command) -> Command:
    """Add `--output`, `--domain-id` and `--namespace` to a verb."""
    for option in (
        click.option("--namespace", default="", help="Namespace of all nodes, such as cell_1."),
        click.option(
            "--domain-id",
            type=click.IntRange(0, 232),
            help="ROS domain id; by default ROS_DOMAIN_ID, else the first that no other measurement here uses.",
        ),
        click.option(
            "-o",
            "--output",
            type=click.Path(path_type=Path),
            help="New folder for everything that is written; by default in ./mtcal_output.",
        ),
    ):
        function = option(function)
    return function


@contextmanager
def bar() -> Iterator[Progress]:
    """A progress bar on standard error; plain lines where that is not a terminal."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = error_console()
    if not console.is_terminal:
        yield _lines(console)
        return
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as shown:
        task = shown.add_task("starting", total=None)
        yield lambda text, done, total: shown.update(task, description=text, completed=done, total=total)


def _lines(console: Console) -> Progress:
    last = ""

    def show(text: str, done: int, total: int) -> None:
        nonlocal last
        if text != last:
            last = text
            console.print(f"{text} ({done} of {total})")

    return show


def figures(document: dict[str, Any]) -> list[tuple[str, str]]:
    """What the result of a session says, in words and micrometres."""
    rows = [
        ("readings used", f"{document['used']} of {document['observations']}"),
        ("RMS residual", f"{document['rms_residual'] * 1e6:.3f} µm"),
    ]
    chi = document.get("reduced_chi_square")
    if chi is not None:
        rows.append(("reduced chi-square", f"{chi:.2f} (1 if the model and the declared uncertainty are right)"))
    error_map = document.get("error_map") or {}
    error, uncertainty = _array(error_map.get("position_error")), _array(error_map.get("position_error_u"))
    if error.size:
        rows.append(("points of the map", str(len(error))))
        rows.append(("error of position", f"{_rms(error):.2f} µm RMS, {_largest(error):.2f} µm at most"))
    if uncertainty.size:
        rows.append(
            (
                "its uncertainty U (k = 2)",
                f"{2 * _rms(uncertainty):.2f} µm RMS, {2 * _largest(uncertainty):.2f} µm at most",
            )
        )
    missing = document.get("not_determined") or []
    if missing:
        names = ", ".join(entry["name"] for entry in missing[:6])
        rows.append(("not determined", f"{names}{' …' if len(missing) > 6 else ''}"))
    return rows


def _array(value: Any) -> np.ndarray:
    return np.array([[np.nan if v is None else v for v in row] for row in value]) if value else np.zeros((0, 3))


def _rms(vectors: np.ndarray) -> float:
    """Root mean square length of vectors, micrometres."""
    return float(np.sqrt(np.mean(np.nansum(vectors**2, axis=1)))) * 1e6


def _largest(vectors: np.ndarray) -> float:
    """Greatest length of a vector, micrometres."""
    return float(np.sqrt(np.max(np.nansum(vectors**2, axis=1)))) * 1e6


def show_result(console: Console, measured: Measured) -> None:
    """The measurement's figures as a table."""
    from rich.table import Table

    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_row("measured", f"{len(measured.session.readings)} readings in {measured.seconds[1]:.1f} s")
    for name, number in measured.counters.items():
        if number and name in ("unstable", "recoveries", "restarts"):
            table.add_row(name, str(number))
    if measured.result is not None:
        for name, text in figures(measured.result):
            table.add_row(name, text)
    console.print(table)


def show_files(console: Console, measured: Measured, more: list[tuple[str, Path]] | None = None) -> None:
    """Where everything is."""
    from rich.table import Table

    table = Table(show_header=False, box=None, pad_edge=False)
    rows: list[tuple[str, Path | None]] = [
        ("recording", measured.bag),
        ("session", measured.session_folder),
        ("result", measured.result_file),
        *(more or []),
        ("logs of the nodes", measured.output / "log"),
    ]
    for name, path in rows:
        if path is not None:
            table.add_row(name, str(path))
    console.print(table)
