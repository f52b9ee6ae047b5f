# SPDX-License-Identifier: Apache-2.0
"""`mtcal check`: whether an earlier map still predicts a measurement."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from machine_tool_calibration.cli.diagnosing import Wanted, model_options
from machine_tool_calibration.cli.logbook import machine_option
from machine_tool_calibration.cli.shared import PATH, json_option, progress_bar, seed_option, tell
from machine_tool_calibration.errors import CalibrationError

if TYPE_CHECKING:
    from machine_tool_calibration.methods.fitted import FitRequest
    from machine_tool_calibration.trends.logbook import Entry
    from machine_tool_calibration.trends.statement import Statement


@click.command("check")
@click.argument("earlier", metavar="MAP", type=PATH)
@click.argument("measurement", metavar="SESSION", type=PATH)
@machine_option
@model_options
@seed_option
@json_option
def command(earlier: Path, measurement: Path, machine: str | None, wanted: Wanted, seed: int, as_json: bool) -> None:
    """Say whether an earlier map of a machine still predicts a measurement, and what has changed if not.

    MAP is a logbook (the last entry of the machine before SESSION counts), a session or recording, or a result document
    (`result.json` of `mtcal identify -o`, without correlations). SESSION is identified by the same model as MAP, unless
    another one is asked for; with --from-history MAP's is that of its history, or where it has none of SESSION's, and
    readings that either history sets aside are left out. Error motions, squareness, reversal, effects and the position
    errors are compared one by one; p-values are adjusted for their number (Holm).

    \b
    mtcal check mill.logbook june
    mtcal check january/result.json june
    mtcal check january june --model rigid_body --json
    mtcal check january june --from-history
    """
    from machine_tool_calibration.interface.trends import Check
    from machine_tool_calibration.methods.identify import fitted_sessions, identify_sessions
    from machine_tool_calibration.session.provenance import name_of_machine
    from machine_tool_calibration.trends.check import check
    from machine_tool_calibration.trends.logbook import Logbook, is_logbook
    from machine_tool_calibration.trends.statement import of_fit, of_result

    map_has_history, session_has_history = wanted.have_history([earlier, measurement])
    asked = replace(wanted, from_history=session_has_history).open([measurement]).chosen
    history: list[Statement] = []
    with progress_bar() as progress:

        def state(request: FitRequest, label: str) -> Statement:
            progress(f"identifying {label}", None)
            return of_fit(fitted_sessions(identify_sessions(request)), label, seed=seed, progress=progress)

        if is_logbook(earlier):
            named = machine or name_of_machine(asked.sessions[0].description.about)
            entries = _before(Logbook(earlier).of_one(named or None), asked)
            method = asked.sessions[0].method
            last = ([one for one in entries if one.result["method"] == method] or entries)[-1]
            model, effects = last.result["model"], tuple(last.result["effects"])
            base = replace(asked, sessions=(last.session,), model=model, effects=effects)
            first = replace(state(base, last.label), date=last.date)
            keys = ("method", "model", "effects")
            alike = [e for e in entries if all(str(e.result.get(k)) == str(last.result.get(k)) for k in keys)]
            history = [of_result(one.result, one.label) for one in alike]
        elif (document := _document(earlier)) is not None:
            first = of_result(document, str(earlier))
            base = replace(asked, model=first.model, effects=first.effects)
        else:
            base = replace(wanted, from_history=map_has_history).open([earlier]).chosen
            if session_has_history and not map_has_history:
                base = replace(base, model=asked.model, effects=asked.effects, own=asked.own)
            first = state(base, str(earlier))
        if {one.method for one in base.sessions} == {one.method for one in asked.sessions}:
            asked = replace(asked, model=wanted.model or base.model, effects=wanted.effects or base.effects)
        asked = replace(asked, own=base.own) if map_has_history else asked
        answer = Check.of(check(first, state(asked, str(measurement)), history))
    tell(answer, as_json)


def _before(entries: tuple[Entry, ...], asked: FitRequest) -> list[Entry]:
    """Entries before the measurement, which may be entered itself."""
    from machine_tool_calibration.session.provenance import provenance
    from machine_tool_calibration.trends.logbook import date_of, last_moment

    origin = provenance(asked.sessions)
    sums = [entry.sha256 for entry in entries]
    found = list(entries[: sums.index(origin.sha256)] if origin.sha256 in sums else entries)
    if origin.sha256 not in sums and (date := origin.sessions[0].measured):
        when = last_moment(date_of(date, asked.sessions[0].source))
        found = [entry for entry in found if entry.moment <= when]
    if not found:
        raise CalibrationError(f"{entries[0].machine}: the logbook has no entry before this measurement")
    return found


def _document(path: Path) -> dict[str, object] | None:
    """A result document, also that in a folder of `mtcal identify -o`; None where the path is something else."""
    file = path / "result.json" if path.is_dir() and not (path / "session.yaml").exists() else path
    if file.suffix != ".json" or not file.is_file():
        return None
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CalibrationError(f"{file}: cannot be read as a result document: {error}") from None
    if not isinstance(found, dict):
        raise CalibrationError(f"{file}: is no result document")
    return found
