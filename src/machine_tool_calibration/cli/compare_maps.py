# SPDX-License-Identifier: Apache-2.0
"""`mtcal compare-maps`: whether two measurements of one machine agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from machine_tool_calibration.cli import shared
from machine_tool_calibration.cli.diagnosing import Wanted, model_options
from machine_tool_calibration.errors import ModelError, did_you_mean
from machine_tool_calibration.session.catalogue import spec_of

if TYPE_CHECKING:
    from machine_tool_calibration.reports.identification import Measured


@click.command("compare-maps")
@click.argument("first", type=shared.PATH)
@click.argument("second", type=shared.PATH)
@model_options
@shared.seed_option
@click.option("--plot", type=shared.PictureFile(), help="Draw both maps into this file (png, svg, pdf).")
@shared.json_option
def command(first: Path, second: Path, wanted: Wanted, seed: int, plot: Path | None, as_json: bool) -> None:
    """Say whether two measurements of one machine agree within their joint uncertainty.

    FIRST and SECOND are session folders or recordings, of any methods: a tracking interferometer and a grid encoder,
    say, or one instrument before and after. Each is identified by itself, with the effects and the model that its
    method has of those asked for, or with what its history has in use. At the points that both maps have, the
    motion between their datums is taken out, and what is left is divided by its expanded uncertainty (k = 2): the
    normalised difference E_n, within ±1 where the maps agree.

    \b
    mtcal compare-maps tracking grid
    mtcal compare-maps tracking grid --plot comparison.png
    mtcal compare-maps before after --from-history
    """
    from machine_tool_calibration.interface.identification import Fit
    from machine_tool_calibration.interface.session import Measurement
    from machine_tool_calibration.methods.identify import identify_sessions

    one, two = shared.session_labels([first, second])
    with shared.progress_bar() as progress:
        fits = []
        for own, label in zip(_measured(wanted, (first, second)), (one, two), strict=True):
            progress(f"identifying {label}", None)
            fits.append(Fit(Measurement(own.recorded, (label,)), identify_sessions(own.chosen), own.chosen))
        answer = fits[0].compare_map(fits[1], (one, two), seed=seed, progress=progress)
    shared.save_picture(answer.plot, plot)
    shared.tell(answer, as_json)


def _measured(wanted: Wanted, paths: Sequence[Path]) -> list[Measured]:
    """The measurements, each with what its method knows of the model that is asked for, or with its history's.

    A UsageError if effects or a model are asked for beside those of the history; a CalibrationError if neither has a
    history, knows the model, or can have an effect.
    """
    from machine_tool_calibration.effects.catalogue import find_effects

    having = wanted.have_history(paths)
    if wanted.from_history:
        out = [replace(wanted, from_history=own).open([path]) for path, own in zip(paths, having, strict=True)]
        for path, own in zip(paths, having, strict=True):
            if not own:
                shared.note(f"{path}: no model was tried yet; its method's own is compared")
        return out
    out = [replace(wanted, model=None, effects=()).open([path]) for path in paths]
    known = sorted({name for one in out for name in spec_of(one.recorded[0]).models})
    if wanted.model is not None and wanted.model not in known:
        raise ModelError(f"neither measurement has a model {wanted.model!r}{did_you_mean(wanted.model, known)}")
    found: list[Measured] = []
    for one in out:
        chosen, variants = one.chosen, spec_of(one.recorded[0]).models
        chosen = replace(chosen, model=wanted.model if wanted.model in variants else None)
        observations = chosen.base(chosen.sessions[0])[0].observations
        acting = (e.id for e in find_effects(wanted.effects, chosen.own) if e.why_not(observations) is None)
        found.append(replace(one, chosen=replace(chosen, effects=tuple(acting))))
    for name in wanted.effects:
        if not any(name in one.chosen.effects for one in found):
            raise ModelError(f"neither measurement can have the effect {name}")
    return found
