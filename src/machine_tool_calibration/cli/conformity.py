# SPDX-License-Identifier: Apache-2.0
"""`mtcal conformity`: whether the machine keeps its tolerances, and how sure that is."""

from collections.abc import Sequence
from pathlib import Path

import click

from machine_tool_calibration.budget.conformity import RULES
from machine_tool_calibration.budget.contributor import known_contributors
from machine_tool_calibration.cli.budget import budget_option
from machine_tool_calibration.cli.diagnosing import Wanted, model_options, sessions_argument
from machine_tool_calibration.cli.shared import PATH, Number, json_option, note, progress_bar, seed_option, tell
from machine_tool_calibration.session.session import Session


@click.command("conformity")
@sessions_argument
@click.option(
    "--tolerance", "texts", metavar="NAME=VALUE", multiple=True, help="A tolerance, such as EXX=10um; repeatable."
)
@click.option("--tolerances", "file", type=PATH, help="YAML file with tolerances.")
@click.option(
    "--rule",
    type=click.Choice([*RULES, "shared-risk"]),
    default="guarded",
    show_default=True,
    help="Decision rule of ISO 14253-1 (guarded) or JCGM 106; shared-risk is simple acceptance.",
)
@click.option(
    "--probability",
    type=Number(0.5, 1.0, min_open=True, max_open=True),
    default=0.95,
    show_default=True,
    help="Conformance probability of the rule.",
)
@budget_option(
    "YAML file with the contributors; the session's own, else its instrument's to begin with (`mtcal budget`)."
)
@seed_option
@model_options
@json_option
def command(
    measurements: tuple[Path, ...],
    texts: tuple[str, ...],
    file: Path | None,
    rule: str,
    probability: float,
    budgets: tuple[Path, ...],
    seed: int,
    wanted: Wanted,
    as_json: bool,
) -> None:
    """Say whether the machine keeps its tolerances: pass, fail or undecided, with the probability.

    SESSION is a session folder or a recording. A tolerance is that of an error motion (its range over the axis), of a
    squareness (its absolute value), of a figure of ISO 230-2 (A, R, E, M, B, B_mean; A_X of one axis; A_up, A_down of
    one direction of approach, R and E alike) or of ISO 230-4 (G_ccw, G_cw, G_b, H, F_max_ccw, F_min_ccw, D; G_b.XY of
    one setup), or of the volumetric error (volumetric: the largest position error of the map). What the data does not
    determine never passes, and nothing is decided without a budget: what the readings
    themselves show lacks instrument and temperature.

    \b
    mtcal conformity session --tolerance EXX=10um --tolerance C0Y=20urad
    mtcal conformity session --tolerance volumetric=30um --rule simple
    mtcal conformity session --tolerances tolerances.yaml --budget mine.yaml --json
    """
    from machine_tool_calibration.budget.tolerances import parse_tolerances, read_tolerances

    tolerances = (read_tolerances(file) if file is not None else {}) | parse_tolerances(texts)
    if not tolerances:
        raise click.UsageError("Missing --tolerance NAME=VALUE or --tolerances FILE.")
    with progress_bar() as progress:
        fit = wanted.fit(measurements, progress)
        wanted.note_unused(fit, measurements)
        if not budgets:
            _note_budget(fit.measurement.sessions)
        budget = fit.budget(budgets, seed=seed, progress=progress) if budgets else None
        named = "simple" if rule == "shared-risk" else rule
        answer = fit.conformity(tolerances, rule=named, level=probability, budget=budget, seed=seed, progress=progress)
    tell(answer, as_json)


def _note_budget(sessions: Sequence[Session]) -> None:
    """Say whose budget decides where none is given, or what to do where there is none."""
    from machine_tool_calibration.budget.complete import declared_contributors

    lines, why = known_contributors(sessions)
    if not lines:
        note(f"note: no tolerance is decided, as U is without instrument and temperature: {why}")
    elif not declared_contributors(sessions):
        names = ", ".join(dict.fromkeys(str(session.instrument) for session in sessions))
        note(f"note: U is by the budget to begin with of {names}; yours: `mtcal budget --template`, then --budget FILE")
