"""`mtcal convert`: sessions, recordings and tables into one another."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from machine_tool_calibration.cli.info import topic_names, topic_option
from machine_tool_calibration.cli.output import console, json_option, note, write_json
from machine_tool_calibration.errors import CalibrationError

__all__ = ["command"]

_TABLES = (".csv", ".parquet")


@click.command("convert")
@click.argument("source", type=click.Path(path_type=Path))
@click.argument("target", type=click.Path(path_type=Path))
@click.option(
    "--to",
    "form",
    type=click.Choice(["session", "bag", "csv", "parquet"]),
    help="What TARGET becomes. By default a table where its name ends in .csv or .parquet, a session of a "
    "recording, and a recording of a session.",
)
@click.option("--start", type=click.IntRange(min=0), default=0, help="Bag: when the session began, ns since 1970.")
@click.option("--namespace", default="", help="Bag: namespace of its topics.")
@topic_option
@json_option
def command(
    source: Path,
    target: Path,
    form: str | None,
    start: int,
    namespace: str,
    topics: tuple[str, ...],
    as_json: bool,
) -> None:
    """Convert a session into a recording, a recording into a session, and either into tables.

    SOURCE is a session folder or a recording. Numbers stay the same to the last bit. `--to csv` and `--to parquet` with
    a recording and a folder as TARGET write every topic into a table of its own; with a file as TARGET, the readings
    into that one table.

    \b
    mtcal convert session bag
    mtcal convert bag session
    mtcal convert bag readings.csv
    mtcal convert bag tables --to parquet
    """
    from machine_tool_calibration.session.open import is_session_folder

    names = topic_names(topics)
    if not source.exists():
        raise CalibrationError(f"{source}: no such file or folder")
    from_session = is_session_folder(source)
    if form is None:
        form = target.suffix.lstrip(".") if target.suffix in _TABLES else "bag" if from_session else "session"
    if form in ("csv", "parquet"):
        if target.suffix in _TABLES and target.suffix != f".{form}":
            raise click.UsageError(f"{target} does not end in .{form}")
        document = _tables(source, target, form, from_session, names)
    else:
        document = _measurement(source, target, form, start, namespace, names)
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


def _measurement(
    source: Path, target: Path, form: str, start: int, namespace: str, names: dict[str, str]
) -> dict[str, Any]:
    from machine_tool_calibration.recording.session_to_bag import session_to_bag
    from machine_tool_calibration.session.open import open_measurement
    from machine_tool_calibration.session.writer import write_session

    session = open_measurement(source, names, check=False)
    if form == "bag":
        session_to_bag(session, target, start=start, namespace=namespace)
    else:
        write_session(session, target)
    return {"readings": len(session.readings)}


def _tables(source: Path, target: Path, form: str, from_session: bool, names: dict[str, str]) -> dict[str, Any]:
    from machine_tool_calibration.recording.reader import BagReader
    from machine_tool_calibration.recording.tables import save_table, save_tables
    from machine_tool_calibration.session.open import open_measurement
    from machine_tool_calibration.session.writer import readings_frame

    if target.exists() and not target.is_dir():
        raise CalibrationError(f"{target}: is there already; choose another name")
    if from_session or target.suffix == f".{form}":
        file = target if target.suffix == f".{form}" else target / f"observations.{form}"
        session = open_measurement(source, names, check=False)
        save_table(iter([readings_frame(session)]), file)
        return {"readings": len(session.readings)}
    files, skipped = save_tables(BagReader(source), target, form)
    return {"topics": files, "skipped": skipped}
