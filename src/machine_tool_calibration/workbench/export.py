# SPDX-License-Identifier: Apache-2.0
"""The page that hands over: the report, tables, documents, and files for a controller with what they would leave."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd
import panel as pn

from machine_tool_calibration.diagnosis.comparison import Comparison
from machine_tool_calibration.diagnosis.history import Entry
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.export import FORMATS
from machine_tool_calibration.export.compensation import Exported, compensation
from machine_tool_calibration.methods.identify import identify
from machine_tool_calibration.plots.compensation import draw_compensation
from machine_tool_calibration.plots.style import save_as
from machine_tool_calibration.report.evaluation import Chosen, evaluate
from machine_tool_calibration.report.page import write_report
from machine_tool_calibration.report.words import LANGUAGES, words
from machine_tool_calibration.reports.comparison import comparison_columns, joint_columns
from machine_tool_calibration.reports.compensation import absent_words, left_table
from machine_tool_calibration.reports.documents import to_json, write_table
from machine_tool_calibration.reports.result_tables import tidy
from machine_tool_calibration.workbench.look import bar_button, tables, text, when_changed
from machine_tool_calibration.workbench.models import Model, Progress, Subject
from machine_tool_calibration.workbench.readings import Readings
from machine_tool_calibration.workbench.saved import Saved, refuse_others
from machine_tool_calibration.workbench.state import Job, State
from machine_tool_calibration.workbench.work import Work

__all__ = ["ExportPage", "reported", "written_tables"]

_LANGUAGES = {"en": "English", "de": "Deutsch"}
_CONTROLLERS = {
    "linuxcnc": "LinuxCNC",
    "linuxcnc-trims": "LinuxCNC, trims (COMP_FILE_TYPE 1)",
    "siemens": "SINUMERIK 840D",
    "fanuc": "Fanuc",
    "isg": "ISG / TwinCAT CNC",
    "etalon": "Etalon Exchange",
    "csv": "tables as CSV",
    "json": "tables as JSON",
}
_PICTURE = "what_is_left.png"


def reported(
    subject: Subject,
    model: Model,
    history: Sequence[Entry],
    language: str,
    files: Sequence[Path],
    diagnosis: bool,
    progress: Progress,
) -> list[Path]:
    """Write the report of a model.

    Args:
        subject: the measurement.
        model: the model.
        history: the models on the way to it, and itself.
        language: of the report.
        files: each by its ending an HTML page or a PDF.
        diagnosis: whether to look for what the model lacks.
        progress: told what is being done.

    Returns:
        The files.
    """
    fit = model.fit
    chosen = Chosen(
        subject.without((), model.kept).sessions,
        fit.measurement.sessions,
        model.labels,
        fit.variant,
        fit.effects,
        subject.own,
        tuple(fit.result.averaged),
        keep_all=True,
        history=tuple(history) if len(history) > 1 else (),
    )
    found = evaluate(chosen, diagnosis=diagnosis, progress=lambda what, share: progress(what, 0.9 * share))
    progress("drawing", 0.9)
    return write_report(found, words(language), files)


def written_tables(model: Model, folder: Path, progress: Progress) -> list[Path]:
    """Write what a model found: errors with their U, every reading with its residual, and the document for programs.

    Returns:
        The files.
    """
    result, origin, held = model.fit.result, model.fit.result.provenance, model.comparison
    columns = comparison_columns(held) if isinstance(held, Comparison) else joint_columns(held)
    errors = write_table(tidy(result), folder / _TABLES[0], origin)
    progress("readings", 0.5)
    readings = write_table(pd.DataFrame(dict(columns)), folder / _TABLES[1], origin)
    document = folder / _TABLES[2]
    document.write_text(to_json(result.document()) + "\n", encoding="utf-8")
    return [errors, readings, document]


_TABLES = ("errors.csv", "readings.csv", "result.json")


def left(subject: Subject, model: Model, form: str, progress: Progress) -> tuple[Exported, bytes]:
    """A controller's files, and the picture of what they would leave (PNG).

    A model without tables is fitted as the one that has them, with the same effects and readings.
    """
    fit, result = model.fit, model.fit.result
    sessions = fit.measurement.sessions
    if len(sessions) == 1:
        variant = sessions[0].spec.with_tables
        if variant is not None and variant != result.model_name:
            progress(f"fitting with the model {variant}", 0.1)
            result = identify(sessions[0], model=variant, effects=fit.effects, own=subject.own, keep_all=True)
    source = " + ".join(session.source for session in sessions)
    made = compensation(result, source, subject.own)
    progress("writing and reading the tables", 0.5)
    found = made.exported(form)
    with TemporaryDirectory() as folder:
        picture = Path(folder) / _PICTURE
        save_as(draw_compensation(found.errors, f"{form}: {source}"), picture, made.origin)
        return found, picture.read_bytes()


class ExportPage:
    """Report, tables and controller files of the model in use."""

    title = "Export"

    def __init__(self, state: State, readings: Readings, work: Work) -> None:
        self._state, self._work = state, work
        self._saved = Saved("Save into the folder")
        self._language = pn.widgets.Select(
            name="Language", options={_LANGUAGES.get(name, name): name for name in LANGUAGES}, width=110
        )
        self._diagnosis = pn.widgets.Checkbox(name="with a diagnosis", value=True, margin=(26, 6))
        self._form = pn.widgets.Select(
            name="Controller", options={_CONTROLLERS.get(form, form): form for form in FORMATS}, width=260
        )
        when_changed(self._form, lambda _: self._forget())
        self._left: tuple[str, Exported, bytes] | None = None
        self._preview = text()
        self._picture = pn.pane.PNG(None, sizing_mode="scale_width", max_width=1000, alt_text="errors before and after")
        self._keep = bar_button("Save the files", self._save_files, "primary", disabled=True)
        self.view = pn.Column(
            pn.Row(self._saved.folder),
            self._saved.list,
            text("<h3>Report to hand over</h3>"),
            pn.Row(
                self._language, self._diagnosis,
                pn.Column(
                    pn.Row(
                        bar_button("Save the report as HTML", partial(self._report, "html"), "primary"),
                        bar_button("Save the report as PDF", partial(self._report, "pdf")),
                    ),
                    margin=(14, 0),
                ),
            ),
            text(
                f"<h3>Tables and documents</h3><p>{_TABLES[0]}: all errors with their U (k = 2); {_TABLES[1]}: every "
                f"reading with its residual; {_TABLES[2]}: the map with all that was found, for programs.</p>"
            ),
            bar_button("Save the tables", self._tables, "primary"),
            text("<h3>Compensation for a controller</h3>"),
            pn.Row(
                self._form,
                pn.Column(
                    pn.Row(bar_button("Show what would be left", self._show_left), self._keep), margin=(14, 0)
                ),
            ),
            self._preview,
            self._picture,
            sizing_mode="stretch_width",
        )  # fmt: skip

    def refresh(self) -> None:
        """Another model is in use: what is left of its errors is not known."""
        names = "+".join(path.absolute().name for path in self._state.paths)
        self._saved.folder.value = f"mtcal_output/export_{names}"
        self._forget()

    def _forget(self) -> None:
        self._left, self._keep.disabled = None, True
        self._preview.object, self._picture.object = "", None

    def _paths(self, names: Sequence[str]) -> list[Path] | None:
        """The files in the folder that is given; None, and why on the page, where that cannot be."""
        try:
            paths = [self._saved.place / name for name in names]
            refuse_others(paths, self._saved.written)
        except CalibrationError as error:
            self._work.fail(error)
            return None
        return paths

    def _report(self, ending: str) -> None:
        state, files = self._state, self._paths([f"report.{ending}"])
        if files is not None:
            asked = (state.subject, state.model, state.entries(), self._language.value, files, self._diagnosis.value)
            self._work.run("writing the report", Job(partial(reported, *asked), self._saved.offer))

    def _tables(self) -> None:
        files = self._paths(_TABLES)
        if files is not None:
            job = Job(partial(written_tables, self._state.model, files[0].parent), self._saved.offer)
            self._work.run("writing the tables", job)

    def _show_left(self) -> None:
        form = self._form.value

        def take(found: tuple[Exported, bytes]) -> None:
            self._left, self._keep.disabled = (form, *found), False
            exported, picture = found
            worse = '<p class="error">The errors would grow: do not load these files.</p>' if exported.worse else ""
            self._preview.object = (
                f"{worse}<p>Files: {escape(', '.join(exported.files))}</p>{tables([left_table(exported)])}"
                f"<p>{escape(absent_words(exported))}</p>"
            )
            self._picture.object = picture

        work = partial(left, self._state.subject, self._state.model, form)
        self._work.run("what the controller would leave", Job(work, take))

    def _save_files(self) -> None:
        if self._left is not None:
            form, exported, picture = self._left
            try:
                self._saved.write(self._saved.place / form, {**exported.files, _PICTURE: picture})
            except (CalibrationError, OSError) as error:
                self._work.fail(error)
