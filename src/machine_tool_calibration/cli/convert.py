"""`mtcal convert`: sessions, recordings and tables into one another, and tables of other programs into sessions."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from machine_tool_calibration.cli.foreign_options import SectionedCommand, foreign_options, is_asked, mapping_from
from machine_tool_calibration.cli.info import topic_names, topic_option
from machine_tool_calibration.cli.output import console, json_option, note, write_json
from machine_tool_calibration.errors import CalibrationError

if TYPE_CHECKING:
    from machine_tool_calibration.importing import Imported
    from machine_tool_calibration.session.session import Session

__all__ = ["command", "foreign_document", "show_preview"]


_FIRST = 6
_BESIDE = ("setup", "repeat", "target", "point")


def foreign_document(imported: Imported) -> dict[str, Any]:
    """The preview as a document: what was read from where, the first readings, and remarks."""
    from machine_tool_calibration.session.folder import readings_frame

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

    from machine_tool_calibration.session.folder import readings_frame
    from machine_tool_calibration.session.parse import description_yaml

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


_TABLES = (".csv", ".parquet")
_TEXTS = (".csv", ".txt", ".tsv", ".dat", ".asc")


@click.command("convert", cls=SectionedCommand)
@click.argument("source", type=click.Path(path_type=Path))
@click.argument("target", type=click.Path(path_type=Path), required=False)
@click.option(
    "--to",
    "form",
    type=click.Choice(["session", "bag", "csv", "parquet"]),
    help="What TARGET becomes. By default a table where its name ends in .csv or .parquet, a recording of a session, "
    "and a session of all else.",
)
@click.option("--start", type=click.IntRange(min=0), default=0, help="Bag: when the session began, ns since 1970.")
@click.option("--namespace", default="", help="Bag: namespace of its topics.")
@topic_option
@json_option
@foreign_options
def command(
    source: Path,
    target: Path | None,
    form: str | None,
    start: int,
    namespace: str,
    topics: tuple[str, ...],
    as_json: bool,
    setup_name: str | None,
    dry_run: bool,
    **foreign: Any,
) -> None:
    """Convert sessions, recordings and tables into one another, and tables of other programs into sessions.

    SOURCE is a session folder or a recording. Numbers stay the same to the last bit. `--to csv` and `--to parquet` with
    a recording and a folder as TARGET write every topic into a table of its own; with a file as TARGET, the readings
    into that one table.

    \b
    mtcal convert session bag
    mtcal convert bag session
    mtcal convert bag readings.csv
    mtcal convert bag tables --to parquet

    With --table or --mapping, SOURCE is a text table of another program: a part or plate measured on a CMM, targets
    measured by a laser tracker, readings by ISO 230-2. Nothing is guessed: columns and units are named, and --dry-run
    shows what would be read.

    \b
    A drilled plate on a CMM, with decimal commas:
      mtcal convert plate.csv plate --table points --separator semicolon --decimal comma --encoding latin-1 \\
        --column x=NominalX --column y=NominalY --column "actual_x=X mess" --column "actual_y=Y mess" --unit mm \\
        --chain w-Y-X-b-Z-t --uncertainty 1.5um --term EXX --term EYY --term EYX --term EXY --term C0Y
    Targets measured by a tracker from several stations, each in its own frame:
      mtcal convert tracker.txt volume --mapping tracker.yaml --align --dry-run
    Distances only, from four stations or more, as a tracking interferometer:
      mtcal convert tracker.txt multilateration --table ranges --column setup=Station --column range=Dist \\
        --column x=X --column y=Y --column z=Z --unit mm --station "S1=-900, 200, 350 mm" …
    A positioning run, columns Position, 1 up, 1 down, 2 up, 2 down …, by ISO 230-2:
      mtcal convert x_axis.csv x_axis --table iso230-2 --axis x --column position=Position \\
        --unit mm --unit deviation=um --chain w-X-b-t --uncertainty 0.3um
    """
    from machine_tool_calibration.recording.open import is_session_folder

    names = topic_names(topics)
    if not source.exists():
        raise CalibrationError(f"{source}: no such file or folder")
    if target is None and not dry_run:
        raise click.UsageError("Missing argument 'TARGET'.")
    imported = _imported(source, setup_name, foreign)
    from_session = imported is None and is_session_folder(source)
    if form is None:
        end = "" if target is None else target.suffix
        form = end.lstrip(".") if end in _TABLES else "bag" if from_session else "session"
    if imported is not None:
        preview = foreign_document(imported)
        if not as_json:
            show_preview(imported, whole=dry_run)
        if dry_run or target is None:
            if as_json:
                write_json({"format": "mtcal-converted/1", "source": source, "to": None, **preview})
            return
        document = {**_written(imported.session, target, form, start, namespace), **preview}
    elif dry_run or target is None:
        raise click.UsageError("--dry-run is for tables of other programs: it needs --table or --mapping")
    elif form in ("csv", "parquet"):
        document = _tables(source, target, form, from_session, names)
    else:
        document = _written(_opened(source, names), target, form, start, namespace)
    if as_json:
        write_json({"format": "mtcal-converted/1", "source": source, "target": target, "to": form, **document})
    else:
        console().print(
            f"[bold]{target}[/]: {document['readings']} readings" if "readings" in document else str(target)
        )
        for topic, file in document.get("topics", {}).items():
            console().print(f"  {topic}: {file}")
    for topic in document.get("skipped", ()):
        note(f"{topic} was left out: its messages have a type that cannot be read")


def _imported(source: Path, setup_name: str | None, foreign: dict[str, Any]) -> Imported | None:
    """The session of a foreign table, if the command line speaks of one."""
    from machine_tool_calibration.session.description import DESCRIPTION_FILE, OBSERVATIONS_FILE

    if is_asked(foreign):
        from machine_tool_calibration.importing import import_table, parse_mapping

        content, name = mapping_from(foreign)
        return import_table(source, parse_mapping(content, name), name=setup_name)
    if any(value for value in foreign.values()) or setup_name:
        raise click.UsageError("options for tables of other programs need --table or --mapping")
    known = (DESCRIPTION_FILE, OBSERVATIONS_FILE)
    if source.is_file() and source.suffix.lower() in _TEXTS and source.name not in known:
        raise CalibrationError(
            f"{source}: say what this table holds, with --table points, ranges or iso230-2, or with --mapping"
        )
    return None


def _opened(source: Path, names: dict[str, str]) -> Session:
    """The measurement, unchecked: what is converted need not be enough for its method."""
    from machine_tool_calibration.recording.open import open_measurement

    return open_measurement(source, names, check=False)


def _written(session: Session, target: Path, form: str, start: int, namespace: str) -> dict[str, Any]:
    from machine_tool_calibration.recording.session_bag import session_to_bag
    from machine_tool_calibration.session.folder import write_session

    if form == "bag":
        session_to_bag(session, target, start=start, namespace=namespace)
    elif form == "session":
        write_session(session, target)
    else:
        _save_readings(session, target, form)
    return {"readings": len(session.readings)}


def _save_readings(session: Session, target: Path, form: str) -> None:
    from machine_tool_calibration.recording.tables import save_table
    from machine_tool_calibration.session.folder import readings_frame

    _check_ending(target, form)
    file = target if target.suffix == f".{form}" else target / f"observations.{form}"
    if file.exists():
        raise CalibrationError(f"{file}: is there already; choose another name")
    save_table(iter([readings_frame(session)]), file)


def _check_ending(target: Path, form: str) -> None:
    if target.suffix in _TABLES and target.suffix != f".{form}":
        raise click.UsageError(f"{target} does not end in .{form}")


def _tables(source: Path, target: Path, form: str, from_session: bool, names: dict[str, str]) -> dict[str, Any]:
    from machine_tool_calibration.recording.reader import BagReader
    from machine_tool_calibration.recording.tables import save_tables

    _check_ending(target, form)
    if target.exists() and not target.is_dir():
        raise CalibrationError(f"{target}: is there already; choose another name")
    if from_session or target.suffix == f".{form}":
        session = _opened(source, names)
        _save_readings(session, target, form)
        return {"readings": len(session.readings)}
    files, skipped = save_tables(BagReader(source), target, form)
    return {"topics": files, "skipped": skipped}
