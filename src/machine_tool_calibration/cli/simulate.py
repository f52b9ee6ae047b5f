# SPDX-License-Identifier: Apache-2.0
"""`mtcal simulate`: a session of any method from the virtual machine, with the truth beside it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from machine_tool_calibration.cli.shared import PATH, Number, json_option, tell_either
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.files import save
from machine_tool_calibration.reports.documents import picked, to_json
from machine_tool_calibration.reports.quantities import quantity
from machine_tool_calibration.reports.tables import Part, TextTable
from machine_tool_calibration.session.catalogue import METHODS

if TYPE_CHECKING:
    from machine_tool_calibration.simulation import Simulated


@click.command("simulate", no_args_is_help=True)
@click.argument("paths", nargs=-1, metavar="[SPEC.yaml|PRESET] FOLDER", type=PATH)
@click.option("--method", type=click.Choice(list(METHODS)), help="Measuring method, with its usual plan.")
@click.option("--preset", metavar="NAME", help="A named plan; --list shows them.")
@click.option("--dimension", type=click.Choice(["2", "3"]), help="Tracking interferometer in the plane or in space.")
@click.option(
    "--plan",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="Another value of the plan, such as repeats=3 or pointing=tracking. May be repeated.",
)
@click.option(
    "--effect",
    "effects",
    multiple=True,
    metavar="ID[:KEY=VALUE,…]",
    help="Put an effect in, such as backlash_y or warmup_x:size=4e-6,tau=900. May be repeated.",
)
@click.option("--size", type=float, help="Size of the one effect: the coefficient of its formula, in its unit.")
@click.option("--amplitude", type=float, help="Or the largest change of a reading that it shall make, m.")
@click.option("--machine", type=PATH, help="True errors of the machine (YAML); random otherwise.")
@click.option("--seed", type=click.IntRange(min=0), help="Of all that is random; 0 if not given.")
@click.option("--noise", type=float, help="Standard uncertainty of a reading, m, as declared.")
@click.option("--noise-factor", type=float, help="Actual noise over the declared one; 0: none.")
@click.option("--repeatability", type=float, help="Standard deviation of the machine's position at each visit, m.")
@click.option("--spread", type=float, help="Slope and bow of each mounting, standard deviation, m.")
@click.option("--chips", type=Number(0, 1), help="Fraction of readings with a gross error.")
@click.option("--missing", type=Number(0, 1, max_open=True), help="Fraction of readings that are lost.")
@click.option("--overwrite", is_flag=True, help="Replace a session that is already in the folder.")
@click.option("--list", "listed", is_flag=True, help="List presets and effects, and stop.")
@json_option
def command(
    paths: tuple[Path, ...],
    method: str | None,
    preset: str | None,
    dimension: str | None,
    settings: tuple[str, ...],
    effects: tuple[str, ...],
    size: float | None,
    amplitude: float | None,
    machine: Path | None,
    overwrite: bool,
    listed: bool,
    as_json: bool,
    **numbers: float | None,
) -> None:
    """Simulate a measurement on a virtual machine.

    Readings are computed from geometry: true distances, tilted mirrors, a stylus sphere on a surface, a machine with
    smooth errors. FOLDER gets session.yaml and observations.csv, as from a real measurement, and truth.json, which says
    what was put in: for judging a result, never an input to it. The same options and seed give the same session.

    \b
    mtcal simulate --method tracking_interferometer --dimension 3 --seed 5 --effect backlash_y --size 2e-6 OUT
    mtcal simulate --preset probing_cam --effect workpiece_thermal --amplitude 6e-6 OUT
    mtcal simulate --method step_diagonal --plan "orders=[xyz, yzx, zxy]" --spread 2e-7 OUT
    mtcal simulate SPEC.yaml OUT

    A SPEC.yaml holds `plan` (with its `method`), `seed`, `machine`, `effects` and so on; options come on top of it.
    """
    from machine_tool_calibration.session.folder import write_session
    from machine_tool_calibration.simulation import simulate
    from machine_tool_calibration.simulation.spec import parse_effect, parse_setting, read_spec, spec_from

    if listed:
        _list(as_json)
        return
    if not 1 <= len(paths) <= 2:
        raise click.UsageError("Give the FOLDER to write, and a SPEC.yaml before it if there is one.")
    plan = dict(parse_setting(text) for text in settings)
    if dimension is not None:
        plan["dimension"] = int(dimension)
    chosen = [parse_effect(text) for text in effects]
    if size is not None or amplitude is not None:
        if len(chosen) != 1:
            raise click.UsageError("--size and --amplitude go with one --effect; else write --effect ID:size=VALUE.")
        chosen[0] |= {k: v for k, v in (("size", size), ("amplitude", amplitude)) if v is not None}
    if len(paths) == 2 and preset is None and not paths[0].suffix and not paths[0].exists():  # as `mtcal plan` takes it
        preset, paths = str(paths[0]), paths[1:]
    begun = read_spec(paths[0]) if len(paths) == 2 else None
    fields = {name: value for name, value in numbers.items() if value is not None}
    spec = spec_from(begun, method=method, preset=preset, plan=plan, machine=machine, effects=chosen, fields=fields)
    simulated, folder = simulate(spec), paths[-1]
    truth = folder / "truth.json"
    if truth.exists() and not overwrite:
        raise CalibrationError(f"{folder}: holds a truth.json already; choose another folder, or --overwrite")
    write_session(simulated.session, folder, overwrite=overwrite)
    document = simulated.truth.document() | {"spec": spec.model_dump(mode="json", exclude_unset=True)}
    save(truth, to_json(document) + "\n")
    summary = _summary(simulated, folder)
    tell_either(summary, _parts(summary, simulated), as_json)


def _summary(simulated: Simulated, folder: Path) -> dict[str, Any]:
    session, truth = simulated.session, simulated.truth
    missing = int((session.readings.displacement != session.readings.displacement).sum())
    return {
        "format": "mtcal-simulation/1",
        "folder": str(folder),
        "method": session.method,
        "seed": truth.seed,
        "observations": len(session.readings),
        "missing": missing,
        "outliers": len(truth.outliers),
        "setups": list(session.setup_ids),
        "standard_uncertainty": session.sigma,
        "effects": [chosen.document() for chosen in truth.effects],
        "amplitude": float(abs(truth.signal).max(initial=0.0)),
    }


def _parts(summary: dict[str, Any], simulated: Simulated) -> Iterator[Part]:
    lost = f", {summary['missing']} of them missing" if summary["missing"] else ""
    gross = f", {summary['outliers']} with a gross error" if summary["outliers"] else ""
    setups = f"{len(summary['setups'])} setup{'' if len(summary['setups']) == 1 else 's'}"
    yield (
        f"{summary['method'].replace('_', ' ')}: {summary['observations']} readings{lost}{gross}, "
        f"{setups} ({', '.join(summary['setups'])}), seed {summary['seed']}"
    )
    yield f"declared standard uncertainty {quantity(summary['standard_uncertainty'], 'm')}"
    for chosen in simulated.truth.effects:
        extra = ", ".join(f"{key} {_short(value)}" for key, value in chosen.parameters.items())
        size = quantity(chosen.size, chosen.flaw.unit)
        yield f"effect {chosen.flaw.id}: size {size}{f' ({extra})' if extra else ''}"
    if simulated.truth.effects:
        yield f"the effects change the readings by up to {quantity(summary['amplitude'], 'm')}"
    else:
        yield "no effect beyond the machine's own errors"
    yield f"written to {summary['folder']}: session.yaml, observations.csv, truth.json"
    yield f"next: mtcal identify {summary['folder']}"


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "[" + ", ".join(_short(v) for v in value) + "]" if isinstance(value, list | tuple) else str(value)


def _list(as_json: bool) -> None:
    from machine_tool_calibration.simulation import FLAWS, PRESETS

    known = [picked(flaw, "id", "formula", "unit", "typical", "methods", "listed") for flaw in FLAWS.values()]
    document = {"presets": {name: plan.method for name, plan in PRESETS.items()}, "effects": known}
    presets = tuple((name, plan.method.replace("_", " ")) for name, plan in PRESETS.items())
    rows = tuple((flaw.id, flaw.formula, quantity(flaw.typical, flaw.unit)) for flaw in FLAWS.values())
    effects = TextTable("Effects", ("effect", "what it does", "typical size"), rows)
    tell_either(document, [TextTable("Presets", ("preset", "method"), presets), effects], as_json)
