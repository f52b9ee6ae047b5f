# SPDX-License-Identifier: Apache-2.0
"""`mtcal compare-maps`: whether two measurements of one machine agree."""

from __future__ import annotations

from pathlib import Path

import click

from machine_tool_calibration.cli.diagnosing import note_written
from machine_tool_calibration.cli.output import (
    PictureFile,
    console,
    json_option,
    progress_bar,
    session_labels,
    write_json,
)
from machine_tool_calibration.errors import ModelError, did_you_mean

__all__ = ["command"]


@click.command("compare-maps")
@click.argument("first", type=click.Path(path_type=Path))
@click.argument("second", type=click.Path(path_type=Path))
@click.option("--model", help="Variant of the model, where a measurement's method has it.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of the draws.")
@click.option("--plot", type=PictureFile(), help="Draw both maps into this file (png, svg, pdf).")
@json_option
def command(first: Path, second: Path, model: str | None, seed: int, plot: Path | None, as_json: bool) -> None:
    """Say whether two measurements of one machine agree within their joint uncertainty.

    FIRST and SECOND are session folders or recordings, of any methods: a tracking interferometer and a grid encoder,
    say, or one instrument before and after. Each is identified by itself. At the points that both maps have, the
    motion between their datums is taken out, and what is left is divided by its expanded uncertainty (k = 2): the
    normalised difference E_n, within ±1 where the maps agree.

    \b
    mtcal compare-maps tracking grid
    mtcal compare-maps tracking grid --plot comparison.png
    """
    from machine_tool_calibration.methods.identify import fitted_sessions, identify
    from machine_tool_calibration.methods.map_comparison import compare_fits
    from machine_tool_calibration.recording.open import open_measurement
    from machine_tool_calibration.reports.map_comparison import map_comparison_document, show_map_comparison

    one, two = session_labels([first, second])
    sessions = [open_measurement(first), open_measurement(second)]
    known = sorted({name for session in sessions for name in session.spec.models})
    if model is not None and model not in known:
        raise ModelError(f"neither measurement has a model {model!r}{did_you_mean(model, known)}")
    with progress_bar() as progress:
        fitted = []
        for session, label in zip(sessions, (one, two), strict=True):
            progress(f"identifying {label}")
            variant = model if model in session.spec.models else None
            fitted.append(fitted_sessions(identify(session, model=variant)))
        comparison = compare_fits(fitted[0], fitted[1], (one, two), seed=seed, progress=progress)
    if plot is not None:
        from machine_tool_calibration.plots.map_comparison import draw_map_comparison
        from machine_tool_calibration.plots.style import save_as

        save_as(draw_map_comparison(comparison), plot)
        note_written([plot])
    if as_json:
        write_json({**map_comparison_document(comparison), "provenance": [one.provenance.document() for one in fitted]})
    else:
        show_map_comparison(console(), comparison)
