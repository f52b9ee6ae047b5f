# SPDX-License-Identifier: Apache-2.0
"""`mtcal effects`: the catalogue of physical effects."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import click

from machine_tool_calibration.cli.diagnosing import effects_file_option
from machine_tool_calibration.cli.shared import FOLDER, json_option, note_written, progress_bar, tell_either
from machine_tool_calibration.reports.tables import Part, TextTable

if TYPE_CHECKING:
    from machine_tool_calibration.effects.effect import Effect


@click.command("effects")
@click.argument("ids", metavar="[ID …]", nargs=-1)
@effects_file_option
@click.option(
    "--gallery",
    type=FOLDER,
    help="Folder for a picture of each effect's residuals, made by putting it into perfect data, and a page of them.",
)
@json_option
def command(ids: tuple[str, ...], files: tuple[Path, ...], gallery: Path | None, as_json: bool) -> None:
    """List the physical effects that can be looked for, or say everything about some of them.

    Without ID all effects are listed; those of --effects-file and of installed plugins too. With IDs each is described
    in full, with what every method's default model would leave of it.

    \b
    mtcal effects
    mtcal effects backlash_x warmup_y
    mtcal effects --effects-file my_effects.yaml my_creep --gallery pictures
    """
    from machine_tool_calibration.effects.catalogue import catalogue, find_effects, own_effects
    from machine_tool_calibration.reports.effect_page import effect_document, effects_table

    own = own_effects(files)
    chosen = find_effects(ids, own) if ids else list(catalogue(own).values())
    if gallery is not None:
        from machine_tool_calibration.plots.gallery import draw_gallery

        with progress_bar() as progress:
            written = draw_gallery(chosen, gallery, progress)
        note_written([written[-1]] if len(written) > 5 else written)
    parts: Iterable[Part] = ()
    if ids:
        parts = chain.from_iterable(map(_described, chosen))
    elif gallery is None:
        more = "what the coefficients are, where it is described, what each method leaves of it."
        parts = [effects_table(chosen), f"{len(chosen)} effects; `mtcal effects ID` says {more}"]
    document = {"format": "mtcal-effects/1", "effects": [effect_document(effect) for effect in chosen]}
    tell_either(document, parts, as_json)


def _described(effect: Effect) -> Iterator[Part]:
    from machine_tool_calibration.planning.injected import where_it_shows
    from machine_tool_calibration.reports.effect_page import coefficients_in_words, shown_table

    with progress_bar() as progress:
        progress(f"simulating {effect.id}", None)
        found = where_it_shows(effect)
    enters = "displaces the functional point" if effect.kind == "position" else "changes the reading itself"
    lines = {
        "formula": f"{effect.formula} ({enters})",
        "coefficients": "\n".join(coefficients_in_words(effect)),
        "columns": ", ".join(effect.needs) or "none",
        "methods": ", ".join(m.replace("_", " ") for m in effect.methods) or "all",
        "instruments": ", ".join(i.replace("_", " ") for i in effect.instruments) or "all",
        "source": effect.source,
    }
    if effect.beside:
        lines["looked for"] = f"beside {effect.beside} only, as it looks the same by itself"
    rows = tuple((f"  {name}:", text) for name, text in lines.items())
    yield TextTable(f"{effect.id}: {effect.title}", ("", ""), rows)
    yield shown_table(found)
