# SPDX-License-Identifier: Apache-2.0
"""What `mtcal run` and `mtcal demo` share: options, the progress bar, and what is shown at the end."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from machine_tool_calibration.cli.shared import PATH, RosName, bar, console, options
from machine_tool_calibration.reports.identification import summary_rows
from machine_tool_calibration.reports.tables import TextTable

if TYPE_CHECKING:
    from machine_tool_calibration.nodes.measurement import Counting, Measured

_DOMAIN = click.IntRange(0, 232)
_namespace = click.option(
    "--namespace", type=RosName(space=True), default="", help="Namespace of all nodes, such as cell_1."
)


graph_place = options(
    click.option(
        "--domain-id", "domain", type=_DOMAIN, help="ROS domain id of the graph; by default ROS_DOMAIN_ID, else 0."
    ),
    _namespace,
)
"""Of a graph that runs already."""

graph_options = options(
    click.option(
        "-o", "--output", type=PATH, help="New folder for everything that is written; by default in ./mtcal_output."
    ),
    click.option(
        "--domain-id",
        "domain",
        type=_DOMAIN,
        help="ROS domain id; by default ROS_DOMAIN_ID, else the first that no other measurement here uses.",
    ),
    _namespace,
)
"""Of a graph that is started."""


@contextmanager
def readings_bar() -> Iterator[Counting]:
    """A progress bar of the readings on standard error; plain lines where that is not a terminal."""
    with bar("starting", counted=True) as update:
        screen, last, counted = console(stderr=True), "", 0

        def show(text: str, done: int, total: int) -> None:
            nonlocal last, counted
            if update is not None:
                update(description=text, completed=done, total=total)
            elif text != last:
                # The count once for every change of it: what is done before and after the readings has none.
                screen.print(text if done == counted else f"{text} ({done} of {total} readings)")
                last, counted = text, done

        yield show


def result_table(measured: Measured) -> TextTable:
    """The measurement's figures."""
    rows = [("measured", f"{len(measured.session.readings)} readings in {measured.seconds[1]:.1f} s")]
    counted = (name for name in ("unstable", "recoveries", "restarts") if measured.counters.get(name))
    rows += [(name, str(measured.counters[name])) for name in counted]
    if measured.result is not None:
        rows += summary_rows(measured.result)
    return TextTable("", ("", ""), tuple(rows))


def files_table(measured: Measured, more: Sequence[tuple[str, Path]] = ()) -> TextTable:
    """Where everything is."""
    result = measured.output / "result.json" if measured.result is not None else None
    own = {"recording": measured.bag, "session": measured.session_folder, "result": result}
    rows = [*own.items(), *more, ("logs of the nodes", measured.output / "log")]
    return TextTable("", ("", ""), tuple((name, str(path)) for name, path in rows if path is not None))
