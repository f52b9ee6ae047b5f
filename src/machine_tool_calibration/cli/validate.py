# SPDX-License-Identifier: Apache-2.0
"""`mtcal validate`: the figures of the four papers, done anew."""

from __future__ import annotations

from pathlib import Path

import click

from machine_tool_calibration.cli.diagnosing import note_written
from machine_tool_calibration.cli.output import console, json_option, progress_bar, write_json
from machine_tool_calibration.reports.tables import show_table

__all__ = ["command"]


@click.command("validate")
@click.argument("names", metavar="[STUDY …]", nargs=-1)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the pictures of the papers, drawn from our results.",
)
@click.option(
    "--page",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write all of it as a page in Markdown, with the pictures beside it.",
)
@json_option
def command(names: tuple[str, ...], output: Path | None, page: Path | None, as_json: bool) -> None:
    """Hold the published methods' printed figures against what this package finds for the same measurement.

    STUDY is step_diagonal, tracking, rotary_axis or probing; all of them if none is given. What a paper does not print
    is assumed and said; where a figure does not come out the same, the reason stands beside it.

    \b
    mtcal validate
    mtcal validate rotary_axis -o pictures
    """
    from machine_tool_calibration.reports.validation import study_page, study_table, verdict_of
    from machine_tool_calibration.validation.record import study, study_names

    with progress_bar() as progress:
        studies = [
            study(name, lambda what, share, name=name: progress(f"{name}: {what}", share))  # type: ignore[misc]
            for name in names or study_names()
        ]
    written: list[Path] = []
    folder = output or (page.parent if page is not None else None)
    if folder is not None:
        from machine_tool_calibration.plots.validation import save_pictures

        written = [path for entry in studies for path in save_pictures(entry, folder)]
    if page is not None:
        page.write_text(study_page(studies, [path.name for path in written]), encoding="utf-8")
        written.append(page)
    if as_json:
        write_json({"format": "mtcal-validation/1", "studies": [entry.document() for entry in studies]})
    else:
        for entry in studies:
            show_table(console(), study_table(entry))
            console().print(verdict_of(entry))
    note_written(written)
