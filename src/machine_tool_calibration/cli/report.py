# SPDX-License-Identifier: Apache-2.0
"""`mtcal report`: a measurement and all that it tells, to hand over."""

from pathlib import Path

import click

from machine_tool_calibration.cli.budget import budget_option
from machine_tool_calibration.cli.diagnosing import Wanted, model_options, sessions_argument
from machine_tool_calibration.cli.shared import FILE, FOLDER, PATH, note, note_written, progress_bar, seed_option
from machine_tool_calibration.words import words


@click.command("report")
@sessions_argument
@click.option(
    "-o",
    "--output",
    "outputs",
    type=FILE,
    multiple=True,
    help="The report: a file .html or .pdf; repeatable. By default report.html. Of a certificate also .xml, a DCC.",
)
@click.option("--language", default="en", show_default=True, metavar="en|de", help="Of the report.")
@click.option("--figures", type=FOLDER, help="Folder for the pictures as SVG files.")
@budget_option("YAML file with contributors to the uncertainty (`mtcal budget`); repeatable.")
@click.option("--tolerances", type=PATH, help="YAML file with tolerances (`mtcal conformity`).")
@click.option("--diagnosis/--no-diagnosis", default=True, help="Look for what the model lacks, or not.")
@click.option(
    "--certificate",
    "certificates",
    type=PATH,
    multiple=True,
    help="A certificate to sign in the place of the report: YAML file with laboratory, customer, …; repeatable.",
)
@model_options
@seed_option
def command(
    measurements: tuple[Path, ...],
    outputs: tuple[Path, ...],
    language: str,
    figures: Path | None,
    budgets: tuple[Path, ...],
    tolerances: Path | None,
    diagnosis: bool,
    certificates: tuple[Path, ...],
    wanted: Wanted,
    seed: int,
) -> None:
    """Write a report to hand over: one file that holds all it needs.

    SESSION is a session folder or a recording; several of one machine are fitted together. The report says who
    measured what with what (`about` in session.yaml), shows the map, the error motions with their uncertainty, the
    residuals, what the model lacks, the budget and conformity if there are any, what is not determined, and what it
    was made from.

    \b
    mtcal report session -o report.html
    mtcal report session -o report.html -o report.pdf --language de
    mtcal report session --from-history --budget mine.yaml --tolerances tolerances.yaml
    mtcal report session --certificate laboratory.yaml --certificate order.yaml -o certificate.pdf -o certificate.xml
    """
    from machine_tool_calibration.budget.contributor import contributors_of
    from machine_tool_calibration.budget.tolerances import read_tolerances
    from machine_tool_calibration.certificate.pages import write_certificate
    from machine_tool_calibration.certificate.particulars import DecisionRule, read_certificate
    from machine_tool_calibration.certificate.texts import missing
    from machine_tool_calibration.report.evaluation import evaluate
    from machine_tool_calibration.report.page import check_endings, write_report

    outputs = outputs or (Path("certificate.pdf" if certificates else "report.html"),)
    check_endings(outputs, certificate=bool(certificates))
    spoken = words(language)
    contributors = contributors_of(budgets, ())
    limits = read_tolerances(tolerances) if tolerances else {}
    with progress_bar() as progress:
        measured = wanted.open(measurements)
        own = read_certificate(certificates, measured.recorded) if certificates else None
        agreed = own.decision_rule if own else DecisionRule()
        found = evaluate(
            measured,
            diagnosis=diagnosis and own is None,
            seed=seed,
            contributors=contributors,
            tolerances=limits,
            rule=agreed.rule,
            level=agreed.probability,
            progress=progress,
        )
        if own is None:
            written = write_report(found, spoken, outputs, figures, progress)
        else:
            written = write_certificate(found, own, spoken, outputs, figures, progress)
    note_written(written)
    if own is not None and (lacking := missing(own, found)):
        note(f"draft: ISO/IEC 17025:2017 asks for what is not stated: {lacking}")
