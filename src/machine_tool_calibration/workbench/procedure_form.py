# SPDX-License-Identifier: Apache-2.0
"""A form for a measuring procedure: one that the package brings or a file, with other stations, runs and targets."""

from collections.abc import Callable, Mapping
from html import escape
from pathlib import Path
from typing import Any

import panel as pn
import yaml

from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.nodes.shared import procedure_file, procedure_names
from machine_tool_calibration.procedure import Procedure, parse_procedure
from machine_tool_calibration.session.text import read_text, read_yaml
from machine_tool_calibration.workbench.look import controls, text, when_changed

_AXES = ("x", "y", "z", "a", "b", "c")


def changed_procedure(
    content: Mapping[str, Any],
    *,
    setups: list[str] | None = None,
    repeats: int | None = None,
    dwell: float | None = None,
    counts: Mapping[str, int] | None = None,
) -> str:
    """The text of a procedure's content with other setups (ids; all if absent), repeats, and time at each target, s.

    And with so many targets along each axis of its grid (`counts`); `blocks` of a step diagonal.
    """
    session = dict(content["session"])
    if setups is not None:
        session["setups"] = [one for one in session["setups"] if str(one["id"]) in setups]
    if repeats is not None:
        session["repeats"] = repeats
    out = {**content, "session": session}
    for name, count in (counts or {}).items():
        if name == "blocks":
            session["blocks"] = count
        else:
            path = dict(out["path"])
            out["path"] = path | {"grid": path["grid"] | {name: path["grid"][name] | {"count": count}}}
    if dwell is not None:
        out["motion"] = {**content.get("motion", {}), "dwell": dwell}
    return yaml.safe_dump(out, sort_keys=False, allow_unicode=True, width=120)


def _counts(content: Mapping[str, Any]) -> dict[str, int]:
    """What `changed_procedure` can change of the number of targets."""
    if "blocks" in content["session"]:
        return {"blocks": content["session"]["blocks"]}
    grid = (content.get("path") or {}).get("grid") or {}
    return {name: entry["count"] for name, entry in grid.items() if isinstance(entry, dict)}


class ProcedureForm:
    """The form."""

    def __init__(self, ready: Callable[[bool], None]) -> None:
        self._ready = ready
        self._content: dict[str, Any] = {}
        self.text = ""  # of the procedure as the form says; empty where it is none
        self._name = pn.widgets.Select(name="Procedure", options=["", *procedure_names()], width=190)
        self._file = pn.widgets.TextInput(name="or its file", placeholder="my_procedure.yaml", width=190)
        self._setups = pn.widgets.CheckBoxGroup(name="Setups", inline=True)
        self._repeats = pn.widgets.IntInput(name="Runs of each setup", start=1, end=1000, value=1, width=110)
        self._dwell = pn.widgets.FloatInput(name="Wait at a target, s", start=0.01, value=1.0, step=0.5, width=110)
        self._counts = {
            name: pn.widgets.IntInput(name=label, start=1, end=10_000, value=1, width=110, visible=False)
            for name, label in {**{axis: f"Targets along {axis}" for axis in _AXES}, "blocks": "Blocks"}.items()
        }
        self._choices = pn.Column(
            pn.Row(pn.pane.HTML("<label>Setups that are measured</label>", margin=(8, 6)), self._setups),
            controls(self._repeats, self._dwell, *self._counts.values()),
            visible=False,
        )
        self._said = text()
        when_changed(self._name, lambda name: self._read(name))
        when_changed(self._file, lambda file: self._read(file))
        for field in (self._setups, self._repeats, self._dwell, *self._counts.values()):
            when_changed(field, lambda _: self._check())
        self.view = pn.Column(pn.Row(self._name, self._file), self._choices, self._said)

    @property
    def name(self) -> str:
        """Of the procedure."""
        return str(self._content.get("name", "measurement"))

    def procedure(self) -> Procedure:
        """What the form says; a SessionError says in one line why it is no procedure."""
        return parse_procedure(self.text, self.name)

    def _read(self, name: str) -> None:
        self._content, self._choices.visible = {}, False
        if name:
            try:
                file = procedure_file(name)
                content = read_yaml(Path(file)).value
                parse_procedure(read_text(Path(file)), str(file))
            except (CalibrationError, OSError) as error:
                self._fail(error)
                return
            assert isinstance(content, dict)
            session, counts = content["session"], _counts(content)
            ids = [str(one["id"]) for one in session["setups"]]
            self._setups.param.update(options=ids, value=ids)
            self._repeats.value = session.get("repeats", 1)
            self._dwell.value = (content.get("motion") or {}).get("dwell", 1.0)
            for axis, field in self._counts.items():
                field.param.update(visible=axis in counts, value=counts.get(axis, 1))
            self._content, self._choices.visible = content, True
        self._check()

    def _check(self) -> None:
        if not self._content:
            self.text, self._said.object = "", ""
            self._ready(False)
            return
        shown = {name: field.value for name, field in self._counts.items() if field.visible}
        try:
            self.text = changed_procedure(
                self._content,
                setups=list(self._setups.value),
                repeats=self._repeats.value,
                dwell=self._dwell.value,
                counts=shown,
            )
            self.procedure()
        except CalibrationError as error:
            self._fail(error)
            return
        self._said.object = ""
        self._ready(True)

    def _fail(self, error: Exception) -> None:
        self.text = ""
        self._said.object = f'<p class="error" role="alert">{escape(str(error))}</p>'
        self._ready(False)
