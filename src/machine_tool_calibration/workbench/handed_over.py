# SPDX-License-Identifier: Apache-2.0
"""What is handed over of a model: the report, tables, and files for a controller."""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from machine_tool_calibration.budget import complete
from machine_tool_calibration.diagnosis.history import Entry
from machine_tool_calibration.export.compensation import Exported, compensation
from machine_tool_calibration.files import save
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.plots.maps import draw_compensation
from machine_tool_calibration.plots.style import save_as
from machine_tool_calibration.progress import Progress
from machine_tool_calibration.report.evaluation import evaluate
from machine_tool_calibration.report.page import write_report
from machine_tool_calibration.reports.documents import to_json, write_table
from machine_tool_calibration.reports.identification import Measured
from machine_tool_calibration.reports.result_tables import tidy
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import words
from machine_tool_calibration.workbench.models import Model, Subject

PICTURE = "what_is_left.png"
"""Of the errors before and after."""
TABLES = ("errors.csv", "readings.csv", "result.json")
"""Errors with their uncertainty, readings with their residuals, and all that was found for programs."""


def reported(
    subject: Subject,
    model: Model,
    history: Sequence[Entry],
    language: str,
    files: Sequence[Path],
    diagnosis: bool,
    progress: Progress,
) -> list[Path]:
    """Write the report of a model; the files."""
    way = tuple(history) if len(history) > 1 else ()
    measured = Measured(subject.without((), model.kept).sessions, subject.chosen(model), way)
    found = evaluate(measured, diagnosis=diagnosis, progress=lambda what, share: progress(what, 0.9 * share))
    progress("drawing", 0.9)
    return write_report(found, words(language), files)


def written_tables(model: Model, folder: Path, progress: Progress) -> list[Path]:
    """Write what a model found: errors with their U, every reading with its residual, and the document for programs."""
    result, origin, held = model.fit.result, model.fit.result.provenance, model.comparison
    errors = write_table(tidy(result), folder / TABLES[0], origin)
    progress("readings", 0.5)
    readings = write_table(held.residuals, folder / TABLES[1], origin)
    return [errors, readings, save(folder / TABLES[2], to_json(result.document()) + "\n")]


def left(subject: Subject, model: Model, form: str, progress: Progress) -> tuple[Exported, bytes, str]:
    """A controller's files, the picture of what they would leave (PNG), and the name of the model that they are of.

    A model without tables is fitted as the one that has them, with the same effects and readings.
    """
    fit, result = model.fit, model.fit.result
    sessions = fit.measurement.sessions
    if len(sessions) == 1:
        variant = spec_of(sessions[0]).tables
        if variant is not None and variant != result.model_name:
            progress(f"fitting with the model {variant}", 0.1)
            result = complete.identify(FitRequest(sessions, None, variant, fit.effects, subject.own, keep_all=True))
    source = " + ".join(session.source for session in sessions)
    made = compensation(result, source, subject.own)
    progress("writing and reading the tables", 0.5)
    found = made.exported(form)
    with TemporaryDirectory() as folder:
        picture = Path(folder) / PICTURE
        save_as(draw_compensation(found.errors, f"{form}: {source}"), picture, made.origin)
        return found, picture.read_bytes(), result.model_name
