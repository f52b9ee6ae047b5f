"""What `mtcal convert` shows of a foreign table before it is a session."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from machine_tool_calibration.cli.output import console, note

if TYPE_CHECKING:
    from machine_tool_calibration.session.foreign import Imported

__all__ = ["foreign_document", "show_preview"]

_FIRST = 6
_BESIDE = ("setup", "repeat", "target", "point")


def foreign_document(imported: Imported) -> dict[str, Any]:
    """The preview as a document: what was read from where, the first readings, and remarks."""
    from machine_tool_calibration.session.writer import readings_frame

    return {
        "rows": imported.rows,
        "readings": len(imported.session.readings),
        "columns": {role: {"column": column, "unit": unit} for role, (column, unit) in imported.columns.items()},
        "description": imported.session.description.model_dump(mode="json", exclude_none=True),
        "first": readings_frame(imported.session).head(_FIRST).to_dict(orient="records"),
        "notes": imported.notes,
    }


def show_preview(imported: Imported, *, whole: bool) -> None:
    """Print what was read.

    Args:
        imported: the table.
        whole: also the first readings and the text of session.yaml; otherwise remarks only.
    """
    from rich.markup import escape
    from rich.table import Table

    from machine_tool_calibration.session.parse import description_yaml
    from machine_tool_calibration.session.writer import readings_frame

    session = imported.session
    if whole:
        out = console()
        out.print(f"[bold]{escape(session.source)}[/]: {imported.rows} rows, {len(session.readings)} readings")
        table = Table("quantity", "column", "unit", box=None, pad_edge=False)
        for role, (column, unit) in imported.columns.items():
            table.add_row(role, escape(column), unit)
        out.print(table)
        frame = readings_frame(session).head(_FIRST)
        table = Table(title="first readings, in SI units (m, rad, s)", title_justify="left", box=None, pad_edge=False)
        for name in frame:
            table.add_column(str(name), justify="left" if name in _BESIDE else "right")
        for row in frame.itertuples(index=False):
            table.add_row(*(_shown(value) for value in row))
        out.print(table)
        out.print("session.yaml:", style="bold")
        out.print(escape(description_yaml(session.description).rstrip()))
    for text in imported.notes:
        note(text)


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.9g}"
    return str(value)
