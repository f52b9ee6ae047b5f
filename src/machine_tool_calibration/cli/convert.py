# SPDX-License-Identifier: Apache-2.0
"""`mtcal convert`: sessions, recordings and tables into one another, and tables of other programs into sessions."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from importlib import resources
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import yaml

from machine_tool_calibration.cli import shared
from machine_tool_calibration.cli.info import topic_option
from machine_tool_calibration.errors import CalibrationError
from machine_tool_calibration.reports.tables import Part, TextTable

if TYPE_CHECKING:
    from machine_tool_calibration.importing.build import Imported
    from machine_tool_calibration.session.session import Session

_FIRST = 6  # readings that are shown


def _preview_document(imported: Imported) -> dict[str, Any]:
    from machine_tool_calibration.session.folder import readings_frame

    return {
        "rows": imported.rows,
        "readings": len(imported.session.readings),
        "columns": {role: {"column": column, "unit": unit} for role, (column, unit) in imported.columns.items()},
        "description": imported.session.description.model_dump(mode="json", exclude_none=True),
        "first": readings_frame(imported.session).head(_FIRST).to_dict(orient="records"),
        "notes": imported.notes,
    }


def _preview_parts(imported: Imported) -> Iterator[Part]:
    from machine_tool_calibration.session.folder import readings_frame
    from machine_tool_calibration.session.parse import description_yaml

    session = imported.session
    yield f"{session.source}: {imported.rows} rows, {len(session.readings)} readings"
    read = tuple((role, *column_and_unit) for role, column_and_unit in imported.columns.items())
    yield TextTable("", ("quantity", "column", "unit"), read)
    frame = readings_frame(session).head(_FIRST)
    rows = tuple(tuple(_shown(value) for value in row) for row in frame.itertuples(index=False))
    yield TextTable("first readings, in SI units (m, rad, s)", tuple(map(str, frame)), rows)
    yield f"session.yaml:\n{description_yaml(session.description).rstrip()}"


def _note_read_off(session: Session) -> None:
    """That positions are others than those that were read, which nothing says once they are written."""
    from machine_tool_calibration.session.checks.suspicion import read_off

    for words in read_off(session):
        shared.note(words)


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.9g}"
    return str(value)


_TABLES = (".csv", ".parquet")
_ENDING = re.compile(r"\.[A-Za-z]\w{1,4}")  # a folder's name may hold a point too, as a date does
_TEXTS = (".csv", ".txt", ".tsv", ".dat", ".asc")


_FORM = ("separator", "encoding", "skip", "skip_after_header", "comment", "missing", "time_format")
"""Options of how the text of a table is written, but for those that are given in other words."""

_KINDS = {"file": shared.FILE, "count": click.IntRange(min=0), "pair": shared.Pair()}


def _declared() -> Iterator[Callable[[Any], Any]]:
    table = resources.files("machine_tool_calibration.cli") / "foreign_options.yaml"
    for flag, entry in yaml.safe_load(table.read_text(encoding="utf-8")).items():
        name = [entry.pop("name")] if "name" in entry else []
        kind = click.Choice(entry.pop("choice")) if "choice" in entry else _KINDS.get(entry.pop("kind", ""))
        yield click.option(flag, *name, type=kind, **entry)


_foreign_options = shared.options(*_declared())


def _file_form(given: dict[str, Any]) -> dict[str, Any]:
    form = {key: given[key] or None for key in _FORM}
    form["decimal"] = {"comma": ",", "point": "."}.get(given["decimal"] or "")
    form["header"] = False if given["no_header"] else None
    return {key: value for key, value in form.items() if value is not None}


def _mapping_from(given: dict[str, Any], description: Path | None = None) -> tuple[dict[str, Any], str]:
    """The content of a mapping, and its name for messages: the file, with a session.yaml and the options over it.

    A CalibrationError if the file cannot be read.
    """
    from machine_tool_calibration.importing.mapping import FORMAT, read_mapping
    from machine_tool_calibration.session.text import read_yaml
    from machine_tool_calibration.units import dimension

    path = given["mapping"]
    content: dict[str, Any] = {} if path is None else dict(read_mapping(path))
    content.setdefault("format", FORMAT)
    for key in ("columns", "extras", "values", "origin", "stations", "targets"):
        _update(content, key, dict(given[key]), path)
    named = ([part.strip() for part in text.rpartition("=")] for text in given["units"])
    _update(content, "units", {name if mark else dimension(unit): unit for name, mark, unit in named}, path)
    _update(content, "file", _file_form(given), path)
    content |= {key: given[key] for key in ("table", "sign", "axis", "senses") if given[key]}
    content |= {key: True for key in ("align", "transposed", "actual") if given[key]}
    if given["long"]:
        content["layout"] = "long"
    if given["up"] or given["down"]:
        pairs = zip_longest(given["up"], given["down"])
        runs = [(name, way) for pair in pairs for name, way in zip(pair, ("up", "down"), strict=True)]
        content["runs"] = [{"column": name, "direction": way} for name, way in runs if name is not None]
    session: dict[str, Any] = {key: given[key] for key in ("datum", "instrument")}
    session["standard_uncertainty"] = given["uncertainty"]
    session["machine"] = {"chain": given["chain"]} if given["chain"] else None
    session["terms"] = list(given["terms"]) or None
    session["trust_units"] = given["trust_units"] or None
    if description is not None:
        described = read_yaml(description).value
        if not isinstance(described, dict):
            raise CalibrationError(f"{description}: a session.yaml is a mapping of keys")
        said = {key: value for key, value in described.items() if key != "format"}
        before = content.get("session")
        both = [key for key in said if isinstance(before, dict) and key in before and before[key] != said[key]]
        if both:
            other = f"otherwise than --description {description}: say it in one"
            raise CalibrationError(f"{path}: session says {', '.join(both)} {other}")
        _update(content, "session", said, path)
    _update(content, "session", {key: value for key, value in session.items() if value is not None}, path)
    return content, "command line" if path is None else str(path)


def _update(content: dict[str, Any], key: str, more: dict[str, Any], path: Path | None) -> None:
    before = content.get(key, {})
    if not isinstance(before, dict):
        raise CalibrationError(f"{path}: {key} must be a mapping of keys")
    if key == "session" and isinstance(before.get("machine"), dict) and "machine" in more:
        more = {**more, "machine": {**before["machine"], **more["machine"]}}
    if before or more:
        content[key] = {**before, **more}


@click.command("convert")
@click.argument("paths", metavar="SOURCE… [TARGET]", nargs=-1, required=True, type=shared.PATH)
@click.option(
    "--to",
    "form",
    type=click.Choice(["session", "bag", "csv", "parquet"]),
    help="What TARGET becomes. By default a table where its name ends in .csv or .parquet, a recording of a session, "
    "and a session of all else.",
)
@click.option("--start", type=click.IntRange(min=0), default=0, help="Bag: when the session began, ns since 1970.")
@click.option("--namespace", type=shared.RosName(space=True), default="", help="Bag: namespace of its topics.")
@click.option(
    "--description",
    type=shared.FILE,
    help="The session.yaml of a table: one with the columns of observations.csv in SI units (by default the one beside "
    "it), or one that --table or --mapping says how to read.",
)
@topic_option
@shared.json_option
@_foreign_options
def command(
    paths: tuple[Path, ...],
    form: str | None,
    start: int,
    namespace: str,
    description: Path | None,
    topics: dict[str, str],
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
    mtcal convert readings.csv session --description session.yaml     back again
    mtcal convert session mended --separator semicolon --decimal comma    after a spreadsheet had it

    With --table or --mapping, SOURCE is a text table of another program: a part or plate measured on a CMM, targets
    measured by a laser tracker, readings by ISO 230-2, or the readings of any method. Several of the same form become
    one session, each with setups of its own. Nothing is guessed: columns and units are named, and --dry-run shows what
    would be read. What looks like another unit is refused; --trust-units takes it as it is, and so does everything that
    reads the session.

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
    Readings of a step diagonal or any other method, in columns named as those of observations.csv but for --column:
      mtcal convert steps.csv steps --table readings --description session.yaml --unit mm \\
        --column "displacement=Reading [um]"
    """
    from machine_tool_calibration.recording.open import is_session_folder, open_measurement

    # A look at what would be read may do without a target, which is the last path.
    looks = dry_run and (len(paths) == 1 or paths[-1].is_file())
    if len(paths) == 1 and not looks:
        raise click.UsageError("Missing argument 'TARGET'.")
    sources, target = (paths, None) if looks else (paths[:-1], paths[-1])
    source = sources[0]
    for path in sources:
        if not path.exists():
            raise CalibrationError(f"{path}: no such file or folder")
    imported = own = None
    if foreign["table"] is not None or foreign["mapping"] is not None:
        from machine_tool_calibration.importing.build import import_table
        from machine_tool_calibration.importing.mapping import parse_mapping

        content, name = _mapping_from(foreign, description)
        imported = import_table(sources, parse_mapping(content, name), name=setup_name)
    else:
        own = _own_table(sources, setup_name, foreign, description)
    from_session = imported is None and own is None and is_session_folder(source)
    if form is None:
        form = _form(target, "bag" if from_session else "session")
    head: dict[str, Any] = {"format": "mtcal-converted/1", "source": source}
    if imported is not None:
        preview = _preview_document(imported)
        if dry_run:
            shared.tell_either({**head, "to": None, **preview}, _preview_parts(imported), as_json)
        if dry_run and not as_json:
            _note_read_off(imported.session)
        for text in () if as_json else imported.notes:
            shared.note(text)
        if dry_run or target is None:
            return
        document = {**_written(imported.session, target, form, start, namespace), **preview}
    elif dry_run or target is None:
        raise click.UsageError("--dry-run is for tables of other programs: it needs --table or --mapping")
    elif own is None and form in ("csv", "parquet"):
        document = _tables(source, target, form, from_session, topics)
    else:
        session = open_measurement(source, topics, check=False) if own is None else own
        if foreign["trust_units"]:
            session = session.trusted
        document = _written(session, target, form, start, namespace)
    read = f": {document['readings']} readings" if "readings" in document else ""
    of_topics = [f"  {topic}: {at}" for topic, at in document.get("topics", {}).items()]
    shared.tell_either({**head, "target": target, "to": form, **document}, [f"{target}{read}", *of_topics], as_json)
    for topic in document.get("skipped", ()):
        shared.note(f"{topic} was left out: its messages have a type that cannot be read")


def _form(target: Path | None, otherwise: str) -> str:
    """What the target's name says that it becomes."""
    end = "" if target is None else target.suffix.lower()
    if end in _TABLES:
        return end.lstrip(".")
    if end == ".mcap":
        return "bag"
    if _ENDING.fullmatch(end):
        raise CalibrationError(
            f"{target}: nothing is written to {end}; tables end in .csv or .parquet, and for a folder of this name say "
            "--to session or --to bag"
        )
    return otherwise


def _own_table(
    sources: Sequence[Path], setup_name: str | None, foreign: dict[str, Any], description: Path | None
) -> Session | None:
    """The session of a table that is written like observations.csv; None if SOURCE is no such table."""
    from machine_tool_calibration.session import DESCRIPTION_FILE, OBSERVATIONS_FILE

    # beside how a table's text is written, and that its sizes are right
    more = any(value for key, value in foreign.items() if key not in (*_FORM, "decimal", "no_header", "trust_units"))
    if len(sources) > 1 or setup_name or more:
        raise click.UsageError("several sources and options for tables of other programs need --table or --mapping")
    source = sources[0]
    form = _file_form(foreign)
    known = (DESCRIPTION_FILE, OBSERVATIONS_FILE)
    is_table = source.is_file() and source.suffix.lower() in (*_TEXTS, ".parquet") and source.name not in known
    if not (is_table or form or description):
        return None
    table = source / OBSERVATIONS_FILE if source.is_dir() else source
    described = description or table.with_name(DESCRIPTION_FILE)
    if not described.exists():
        raise CalibrationError(
            f"{source}: say what this table holds, with --table points, ranges, iso230-2, circles or readings, or with "
            f"--mapping; if it is in SI units with the columns of {OBSERVATIONS_FILE}, with --description "
            f"{DESCRIPTION_FILE}"
        )
    from machine_tool_calibration.importing.own import read_own_table
    from machine_tool_calibration.importing.text_table import FileForm
    from machine_tool_calibration.session.parse import parse_description
    from machine_tool_calibration.session.record import validated
    from machine_tool_calibration.session.text import read_text

    record = parse_description(read_text(described), str(described))
    return read_own_table(table, record, str(described), validated(FileForm, form, ""))


def _written(session: Session, target: Path, form: str, start: int = 0, namespace: str = "") -> dict[str, Any]:
    from machine_tool_calibration.recording.session_bag import session_to_bag
    from machine_tool_calibration.recording.tables import save_table
    from machine_tool_calibration.session.folder import readings_frame, write_session

    _note_read_off(session)
    if form == "bag":
        session_to_bag(session, target, start=start, namespace=namespace)
    elif form == "session":
        write_session(session, target)
    else:
        _check_ending(target, form)
        file = target if target.suffix.lower() == f".{form}" else target / f"observations.{form}"
        if file.exists():
            raise CalibrationError(f"{file}: is there already; choose another name")
        save_table(iter([readings_frame(session)]), file)
    return {"readings": len(session.readings)}


def _check_ending(target: Path, form: str) -> None:
    if target.suffix.lower() in _TABLES and target.suffix.lower() != f".{form}":
        raise click.UsageError(f"{target} does not end in .{form}")


def _tables(source: Path, target: Path, form: str, from_session: bool, topics: dict[str, str]) -> dict[str, Any]:
    from machine_tool_calibration.recording.open import open_measurement
    from machine_tool_calibration.recording.reader import BagReader
    from machine_tool_calibration.recording.tables import save_tables

    _check_ending(target, form)
    if target.exists() and not target.is_dir():
        raise CalibrationError(f"{target}: is there already; choose another name")
    if from_session or target.suffix.lower() == f".{form}":
        return _written(open_measurement(source, topics, check=False), target, form)
    with shared.progress_bar() as progress:
        files, skipped = save_tables(BagReader(source), target, form, progress)
    return {"topics": files, "skipped": skipped}
