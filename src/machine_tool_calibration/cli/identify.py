"""Identify a machine's errors from one session, or from several of the same machine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from machine_tool_calibration.cli.measuring import figures
from machine_tool_calibration.cli.output import console, json_option, plain, write_json

if TYPE_CHECKING:
    from machine_tool_calibration.effects.effect import Effect
    from machine_tool_calibration.session.session import Session

__all__ = ["command"]

_MOST_ROWS = 40


@click.command("identify")
@click.argument("sessions", metavar="SESSION…", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--effect", "effects", metavar="ID", multiple=True, help="Physical effect to add to the model; repeatable."
)
@click.option("--effects-file", type=click.Path(path_type=Path), help="YAML file with effects of your own, by formula.")
@click.option("--model", help="Variant of the method's model, such as free or rigid_body.")
@click.option("--formulation", help="Step diagonal: one of the paper's formulations instead of the estimator.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), help="Folder for the result document and the pictures."
)
@json_option
def command(
    sessions: tuple[Path, ...],
    effects: tuple[str, ...],
    effects_file: Path | None,
    model: str | None,
    formulation: str | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Identify the machine's errors, each with its uncertainty.

    SESSION is a session folder or a recording. Several sessions of one machine, of the same or of different methods,
    are fitted together and checked for contradictions. What the data cannot determine is named instead of given as a
    number.

    \b
    mtcal identify session
    mtcal identify session --effect backlash_y --model rigid_body
    mtcal identify tracking grid_plate --json
    """
    from machine_tool_calibration.effects.formula import read_effects
    from machine_tool_calibration.session.open import open_measurement

    own = read_effects(effects_file) if effects_file else []
    opened = [open_measurement(path) for path in sessions]
    document = plain(_document(opened, sessions, effects, own, model, formulation))
    pictures = _write(document, opened, output) if output else []
    if as_json:
        write_json(document)
        return
    _show(document)
    for path in pictures:
        console().print(f"written: {path}")


def _document(
    opened: list[Session],
    paths: tuple[Path, ...],
    effects: tuple[str, ...],
    own: list[Effect],
    model: str | None,
    formulation: str | None,
) -> dict[str, Any]:
    from machine_tool_calibration.methods.identify import identify

    if formulation is not None:
        return _by_formulation(opened, effects, model, formulation)
    if len(opened) == 1:
        return identify(opened[0], model=model, effects=effects, own=own).document()
    from machine_tool_calibration.methods.joint import identify_sessions

    return identify_sessions(opened, _labels(paths), model=model, effects=effects, own=own).document()


def _by_formulation(
    opened: list[Session], effects: tuple[str, ...], model: str | None, formulation: str
) -> dict[str, Any]:
    from machine_tool_calibration.errors import ModelError
    from machine_tool_calibration.methods.step_diagonal.compare import identify_by_formulation

    if len(opened) > 1 or effects or model:
        raise ModelError("--formulation is for one session of a step diagonal, without --effect and --model")
    session = opened[0]
    profiles = identify_by_formulation(session, formulation)
    content: dict[str, Any] = {}
    for axis, error, uncertainty in zip("xyz", profiles.error, profiles.uncertainty, strict=True):
        content |= {axis: error, f"{axis}_u": uncertainty}
    return {
        "format": "mtcal-result/1",
        "method": session.method,
        "formulation": formulation,
        "observations": len(session.readings),
        "effects": [],
        "error_map": content,
    }


def _labels(paths: tuple[Path, ...]) -> list[str]:
    """Names of the sessions: those of their folders, numbered where they repeat."""
    names = [path.resolve().stem for path in paths]
    return [f"{name}#{k + 1}" if names.count(name) > 1 else name for k, name in enumerate(names)]


def _write(document: dict[str, Any], opened: list[Session], output: Path) -> list[Path]:
    from machine_tool_calibration.cli.output import to_json
    from machine_tool_calibration.errors import CalibrationError
    from machine_tool_calibration.plots.pictures import draw

    try:
        output.mkdir(parents=True, exist_ok=True)
        file = output / "result.json"
        file.write_text(to_json(document) + "\n", encoding="utf-8")
    except OSError as error:
        raise CalibrationError(f"{output}: cannot be written: {error.strerror}") from None
    drawn = draw(opened[0], document, output) if len(opened) == 1 and "formulation" not in document else []
    return [file, *drawn]


def _show(document: dict[str, Any]) -> None:
    from rich.table import Table

    screen = console()
    if "formulation" in document:
        _show_profiles(document)
        return
    screen.print(_verdict(document))
    table = Table(show_header=False, box=None, pad_edge=False)
    for name, text in figures(document):
        table.add_row(name, text)
    screen.print(table)
    for entry in document["rejected"][:10]:
        screen.print(f"not used: row {entry['row']}, {entry['reason']}")
    if "agreement" in document:
        screen.print(document["agreement"]["statement"])
    _show_parameters(document)
    for entry in document["not_determined"]:
        screen.print(f"not determined: {entry['name']}: {entry['why']}")
    screen.print(f"datum: {document['datum']}")


def _verdict(document: dict[str, Any]) -> str:
    """How well the model fits, in plain words."""
    chi, p = document["reduced_chi_square"], document["p_value"]
    ratio = chi**0.5
    if p < 1e-3:
        return (
            f"The readings scatter {ratio:.1f} times their declared uncertainty about the model (p = {p:.1g}): "
            "something is missing in it, or the declared uncertainty is too small. `mtcal diagnose` looks for it."
        )
    if p > 1 - 1e-3:
        return f"The readings scatter only {ratio:.2f} times their declared uncertainty: it is stated too large."
    return f"The model fits the readings within their declared uncertainty (p = {p:.2g})."


def _show_parameters(document: dict[str, Any]) -> None:
    from rich.table import Table

    table = Table(title="parameters", title_justify="left", box=None, pad_edge=False)
    for heading in ("name", "value", "u (k = 1)", "U (k = 2)", "unit"):
        table.add_column(heading, justify="left" if heading in ("name", "unit") else "right")
    added = tuple(f"{effect}." for effect in document["effects"])
    ordered = sorted(document["parameters"], key=lambda entry: not entry["name"].startswith(added) if added else True)
    for entry in ordered[:_MOST_ROWS]:
        table.add_row(entry["name"], *_shown(entry["value"], entry["standard_uncertainty"], entry["unit"]))
    console().print(table)
    if len(ordered) > _MOST_ROWS:
        console().print(f"… and {len(ordered) - _MOST_ROWS} more; --json gives all of them")


def _shown(value: float, uncertainty: float, unit: str) -> tuple[str, str, str, str]:
    """Value and uncertainties, in micrometres and microradians for people."""
    factor, name = {"m": (1e6, "µm"), "rad": (1e6, "µrad")}.get(unit, (1.0, unit))
    if unit == "m" and abs(value) > 1e-2:
        factor, name = 1e3, "mm"
    digits = ".6g" if name == "mm" else ".4g"
    return (
        f"{value * factor:{digits}}",
        f"{uncertainty * factor:.2g}",
        f"{2 * uncertainty * factor:.2g}",
        "" if name == "1" else name,
    )


def _show_profiles(document: dict[str, Any]) -> None:
    from rich.table import Table

    for axis in "xyz":
        rows = document["error_map"][axis]
        if not rows:
            continue
        table = Table(title=f"{axis.upper()}: errors by the formulation {document['formulation']}, µm", box=None)
        for heading in ("block", "ex", "ey", "ez"):
            table.add_column(heading, justify="right")
        for k, row in enumerate(rows):
            table.add_row(str(k), *("-" if v is None else f"{v * 1e6:.3f}" for v in row))
        console().print(table)
