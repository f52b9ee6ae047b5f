# SPDX-License-Identifier: Apache-2.0
"""`mtcal compare-formulations`: a step diagonal by every formulation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from machine_tool_calibration.cli.output import PATH, PictureFile, json_option, save_picture, tell_either
from machine_tool_calibration.reports.quantities import plus_minus, quantity, rounded
from machine_tool_calibration.reports.tables import Part, TextTable, suspicion_words

if TYPE_CHECKING:
    from machine_tool_calibration.methods.step_diagonal.compare import FormulationComparison
    from machine_tool_calibration.methods.step_diagonal.profiles import Figure, Profiles

__all__ = ["command"]

_UNITS = {"positioning": "µm", "straightness": "µm", "squareness": "µrad"}
_HEADS = {
    "conventional": "conventional\nEq. (2)",
    "new": "new\nEqs. (6)-(19)",
    "least_squares": "least squares",
    "small_angles": "least squares,\nsmall angles",
}


@click.command("compare-formulations")
@click.argument("measurement", type=PATH)
@click.option("-p", "--plot", type=PictureFile(), help="Draw the profiles into this file (png, svg, pdf).")
@json_option
def command(measurement: Path, plot: Path | None, as_json: bool) -> None:
    """Compare the formulations of a laser step diagonal, as Table 1 of Ibaraki and Hata 2010 does.

    MEASUREMENT is a session folder or a recording of the method step_diagonal. The conventional formulation (Wang)
    takes the mirror to be at right angles to the beam; the new one is immune to its tilt; least squares uses every
    reading, without and with small angular errors of the axes (with them: what `mtcal identify` does).

    \b
    mtcal compare-formulations measurements/diagonals
    mtcal compare-formulations measurements/diagonals --plot profiles.png
    """
    from machine_tool_calibration.methods.step_diagonal.compare import compare_formulations
    from machine_tool_calibration.recording.open import open_measurement
    from machine_tool_calibration.session.checks.suspicion import suspicions

    session = open_measurement(measurement)
    comparison, suspicious = compare_formulations(session), suspicions([session])
    if plot is not None:
        from machine_tool_calibration.plots.step_diagonal import draw_comparison

        save_picture(partial(draw_comparison, comparison), plot)
    parts = chain(_parts(comparison), suspicion_words(suspicious))
    tell_either({**_document(comparison), "suspicious": suspicious}, parts, as_json)


def _document(comparison: FormulationComparison) -> Mapping[str, Any]:
    """SI units; NaN becomes null."""
    return {
        "format": "mtcal-formulations/1",
        "formulations": {name: _profiles(profiles) for name, profiles in comparison.profiles.items()},
        "refused": dict(comparison.refused),
        "mirror_tilts": dict(comparison.tilts),
    }


def _profiles(found: Profiles) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for letter, error, uncertainty, blocks in zip("xyz", found.error, found.uncertainty, found.blocks, strict=True):
        out |= {letter: error, f"{letter}_u": uncertainty, f"{letter}_position": blocks}
    for figure in found.figures():
        kind = out.setdefault(figure.kind, {})
        kind |= {figure.name: figure.value, f"{figure.name}_u": figure.uncertainty}
    return out


def _parts(comparison: FormulationComparison) -> Iterator[Part]:
    title = "Value ± expanded uncertainty (k = 2) from the readings alone"
    rows: list[tuple[str, ...]] = []
    heads = ("figure", *(_HEADS[name] for name in comparison.profiles))
    figures = {
        name: {(f.kind, f.name): f for f in profiles.figures()} for name, profiles in comparison.profiles.items()
    }
    before = ""
    for kind, name in next(iter(figures.values())):
        if before and kind != before:
            rows.append(("",) * len(heads))
        before = kind
        row = [figures[column][kind, name] for column in comparison.profiles]
        rows.append((_label(kind, name, next(iter(comparison.profiles.values()))), *(_cell(f) for f in row)))
    note = (
        "positioning: error at the last block position; straightness: largest minus smallest deviation from the "
        "least-squares line; squareness: slope of one axis's line against the other's"
    )
    yield TextTable(title, heads, tuple(rows), note)
    if "conventional" in comparison.profiles and "new" in comparison.profiles:
        off = [
            np.nanmax(np.abs(a - b))
            for a, b in zip(comparison.profiles["conventional"].error, comparison.profiles["new"].error, strict=True)
        ]
        words = f"The conventional formulation is up to {quantity(float(max(off)), 'm')} from the new one"
        if comparison.tilts:
            tilts = ", ".join(f"{quantity(tilt, 'rad')} in {name}" for name, tilt in comparison.tilts.items())
            words += (
                ": it takes the mirrors to be at right angles to their beams, and what a tilt makes of the way across "
                f"the beam for positioning errors and squareness of the machine. The readings show tilts of {tilts}"
            )
        yield f"{words}."
    for name, why in comparison.refused.items():
        yield f"{name}: {why}"


def _label(kind: str, name: str, profiles: Profiles) -> str:
    unit = _UNITS[kind]
    if kind == "positioning":
        span = 1e3 * float(np.ptp(profiles.blocks["XYZ".index(name[2])]))
        return f"{name} over {span:g} mm / {unit}"
    if kind == "straightness":
        return f"{name} straightness / {unit}"
    pair = "-".join(letter for letter, turn in zip("XYZ", "ABC", strict=True) if turn != name[0])
    return f"{name} squareness {pair} / {unit}"


def _cell(figure: Figure) -> str:
    if not np.isfinite(figure.value):
        return "not determined"
    if not np.isfinite(figure.uncertainty):
        return rounded(1e6 * figure.value)
    return plus_minus(figure.value, figure.uncertainty, 1e6)
