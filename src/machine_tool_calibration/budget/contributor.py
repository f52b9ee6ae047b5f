# SPDX-License-Identifier: Apache-2.0
"""Budgets: YAML files with contributors to the measurement uncertainty, and those of instruments to begin with."""

from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from machine_tool_calibration.errors import ModelError, did_you_mean
from machine_tool_calibration.session.contributor import Contributor, Contributors
from machine_tool_calibration.session.parse import parse_record
from machine_tool_calibration.session.record import Record, validated
from machine_tool_calibration.session.session import Session
from machine_tool_calibration.session.text import read_text


class BudgetFile(Record):
    """What a budget's file holds."""

    format: Literal["mtcal-budget/1"]  # of the file
    instrument: str = ""  # for which it is
    contributors: Annotated[Contributors, Field(min_length=1)]  # the lines, with names that differ


def read_budget(path: Path) -> tuple[Contributor, ...]:
    """The contributors that a file lists; a SessionError names file, line and key of what is wrong in it."""
    return parse_record(read_text(path), str(path), BudgetFile).contributors


def instruments() -> tuple[str, ...]:
    """Instruments with a budget to begin with."""
    return tuple(sorted(p.name.removesuffix(".yaml") for p in _folder().iterdir() if p.name.endswith(".yaml")))


def template(instrument: str) -> str:
    """The text of an instrument's budget to begin with, with its values' sources; a ModelError if there is none."""
    if instrument not in instruments():
        near = did_you_mean(instrument, instruments())
        raise ModelError(f"no budget for the instrument {instrument!r}{near}; there are {', '.join(instruments())}")
    return str((_folder() / f"{instrument}.yaml").read_text(encoding="utf-8"))


def template_of(instrument: str) -> tuple[Contributor, ...]:
    """The contributors of an instrument's budget to begin with; a ModelError if there is none for it."""
    return parse_record(template(instrument), f"{instrument}.yaml", BudgetFile).contributors


def default_budget(sessions: Sequence[Session]) -> tuple[Contributor, ...]:
    """The contributors that sessions state themselves, else those of their instruments' budgets to begin with.

    A ModelError: a session states none and its instrument has none or is not named, or those of one instrument differ.
    """
    each: dict[str | None, tuple[Contributor, ...]] = {}
    for session in sessions:
        name, own = session.instrument, session.description.budget
        if not own and name is None:
            raise ModelError(
                "the session does not name its instrument: `instrument` in session.yaml does, or give a budget "
                f"(`mtcal budget --template INSTRUMENT` prints those of {', '.join(instruments())})"
            )
        lines = own or template_of(str(name))
        if each.setdefault(name, lines) != lines:
            raise ModelError(f"sessions of one instrument, {name}, state different budgets: give one for all of them")
    if len(each) == 1:
        return next(iter(each.values()))
    return tuple(
        line.model_copy(update={"name": f"{name}: {line.name}", "instrument": name or ""})
        for name, lines in each.items()
        for line in lines
    )


def contributors_of(
    given: str | Path | Sequence[Path | Contributor | Mapping[str, Any]] | None, sessions: Sequence[Session]
) -> tuple[Contributor, ...]:
    """Contributors from a file, or lines and files, else of `default_budget`; a CalibrationError: one is wrong."""
    if given is None:
        return default_budget(sessions)
    out = list[Contributor]()
    for number, line in enumerate([Path(given)] if isinstance(given, str | Path) else given, start=1):
        if isinstance(line, Path):
            out += read_budget(line)
        else:
            said = dict(line) if isinstance(line, Mapping) else line  # what is neither is for the check to name
            out.append(validated(Contributor, said, f"contributor {number}", refusal=ModelError))
    return tuple(out)


def known_contributors(sessions: Sequence[Session]) -> tuple[tuple[Contributor, ...], str]:
    """Those of `default_budget`, or none and the reason in words."""
    try:
        return default_budget(sessions), ""
    except ModelError as error:
        return (), str(error)


def _folder() -> Any:
    return resources.files("machine_tool_calibration.budget") / "instruments"
