# SPDX-License-Identifier: Apache-2.0
"""The page that hands over: the report, tables, documents, and files for a controller with what they would leave."""

from functools import partial
from html import escape

import panel as pn

from machine_tool_calibration.export import FORMATS
from machine_tool_calibration.export.compensation import Exported
from machine_tool_calibration.reports.compensation import absent_words, harm_words, left_table
from machine_tool_calibration.words import LANGUAGES
from machine_tool_calibration.workbench.handed_over import PICTURE, TABLES, left, reported, written_tables
from machine_tool_calibration.workbench.look import bar_button, choice, column, controls, tables, text
from machine_tool_calibration.workbench.readings import Readings
from machine_tool_calibration.workbench.saved import Saved
from machine_tool_calibration.workbench.state import Job, State
from machine_tool_calibration.workbench.work import Work

_LANGUAGES = {"en": "English", "de": "Deutsch"}
_CONTROLLERS = {
    "linuxcnc": "LinuxCNC", "linuxcnc-trims": "LinuxCNC, trims (COMP_FILE_TYPE 1)",
    "siemens": "SINUMERIK 840D", "fanuc": "Fanuc", "isg": "ISG / TwinCAT CNC", "etalon": "Etalon Exchange",
    "csv": "tables as CSV", "json": "tables as JSON",
}  # fmt: skip


class ExportPage:
    """Report, tables and controller files of the model in use."""

    title = "Export"
    about = "Report, tables and files for a controller, all of the model in use."
    blocks = 10

    def __init__(self, state: State, readings: Readings, work: Work) -> None:
        self._state, self._work = state, work
        self._saved = Saved("Save into the folder")
        languages = {_LANGUAGES.get(name, name): name for name in LANGUAGES}
        self._language = pn.widgets.Select(name="Language", options=languages, width=110)
        diagnosis = {"made": True, "left out": False}
        self._diagnosis = pn.widgets.Select(name="Diagnosis in the report", options=diagnosis, width=170)
        forms = {_CONTROLLERS.get(form, form): form for form in FORMATS}
        self._form = choice("Controller", lambda _: self._forget(), options=forms, width=260)
        self._left: tuple[str, Exported, bytes] | None = None
        self._preview = text()
        self._picture = pn.pane.PNG(None, sizing_mode="scale_width", max_width=1000, alt_text="errors before and after")
        self._keep = bar_button("Save the files", self._save_files, "primary", disabled=True)
        self.view = column(
            controls(self._saved.folder),
            self._saved.list,
            text("<h3>Report to hand over</h3>"),
            controls(
                self._language, self._diagnosis,
                bar_button("Save the report as HTML", partial(self._report, "html"), "primary"),
                bar_button("Save the report as PDF", partial(self._report, "pdf")),
            ),
            text(
                f"<h3>Tables and documents</h3><p>{TABLES[0]}: all errors with their U (95 %); {TABLES[1]}: every "
                f"reading with its residual; {TABLES[2]}: the map with all that was found, for programs.</p>"
            ),
            bar_button("Save the tables", self._tables, "primary"),
            text("<h3>Compensation for a controller</h3>"),
            controls(self._form, bar_button("Show what would be left", self._show_left), self._keep),
            self._preview,
            self._picture,
        )  # fmt: skip

    def refresh(self) -> None:
        """Another model is in use: what is left of its errors is not known."""
        self._saved.folder.value = "mtcal_output/export_" + "+".join(path.absolute().name for path in self._state.paths)
        self._forget()

    def _forget(self) -> None:
        self._left, self._keep.disabled = None, True
        self._preview.object, self._picture.object = "", None

    def _report(self, ending: str) -> None:
        state, files = self._state, [self._saved.place / f"report.{ending}"]
        asked = (state.subject, state.model, state.entries(), self._language.value, files, self._diagnosis.value)
        self._saved.claim(files)
        self._work.run("writing the report", Job(partial(reported, *asked), self._saved.offer))

    def _tables(self) -> None:
        model, folder = self._state.model, self._saved.place
        self._saved.claim([folder / name for name in TABLES])
        self._work.run("writing the tables", Job(partial(written_tables, model, folder), self._saved.offer))

    def _show_left(self) -> None:
        form = self._form.value

        def take(found: tuple[Exported, bytes, str]) -> None:
            exported, picture, name = found
            self._left, self._keep.disabled = (form, exported, picture), False
            harm = escape(harm_words(exported))
            worse = f'<p class="error">{harm[0].upper()}{harm[1:]}.</p>' if harm else ""
            files = f"<p>Files: {escape(', '.join(exported.files))}</p>"
            self._preview.object = (
                f"{worse}<p>{escape(self._whose(name))}</p>{files}{tables([left_table(exported)])}"
                f"{''.join(f'<p>{escape(words)}</p>' for words in (absent_words(exported), *exported.remarks))}"
            )
            self._picture.object = picture

        work = partial(left, self._state.subject, self._state.model, form)
        self._work.run("what the controller would leave", Job(work, take))

    def _whose(self, name: str) -> str:
        """Which model the files are of, where that in use has no tables."""
        fit = self._state.model.fit
        effects = f" with {', '.join(fit.effects)}" if fit.effects else ""
        own = fit.result.model_name
        instead = f"; the one in use, {own}, has no tables, and what it says is not quite the same"
        return f"Of the model {name}{effects}{'' if own == name else instead}."

    def _save_files(self) -> None:
        if self._left is not None:
            form, exported, picture = self._left
            self._saved.write(self._saved.place / form, {**exported.files, PICTURE: picture})
