# SPDX-License-Identifier: Apache-2.0
"""The options of `mtcal convert` for tables of other programs, and the mapping that they make."""

from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import click

from machine_tool_calibration.cli.shared import FILE, options
from machine_tool_calibration.errors import CalibrationError

_FORM = ("separator", "encoding", "skip", "skip_after_header", "comment", "missing", "time_format")
"""Options of how the text of a table is written, but for those that are given in other words."""

foreign_options = options(
    click.option(
        "--table",
        type=click.Choice(["points", "ranges", "iso230-2", "circles", "readings"]),
        help="SOURCE is a text table: nominal and measured coordinates, distances from a tracker's stations, or "
        "readings by ISO 230-2; `readings`: those of any method, of which --description is the session.yaml.",
    ),
    click.option(
        "--mapping",
        type=FILE,
        help="YAML file (format: mtcal-mapping/1) that says all that the following options say; options come first.",
    ),
    click.option("--dry-run", is_flag=True, help="Show what would be read, in SI units, and write nothing."),
    click.option(
        "--column",
        "columns",
        multiple=True,
        metavar="QUANTITY=NAME",
        help="Column of a quantity: x, y, z (nominal), actual_x … or deviation_x …, setup, point, time, repeat, dir_x, "
        "temperature_air …; ranges: range (or actual_x … from the station), azimuth or bearing, elevation or zenith, "
        "target, c; iso230-2: position, deviation or actual, run, direction; readings: as in observations.csv, where "
        "the table has another name for it.",
    ),
    click.option("--extra", "extras", multiple=True, metavar="NAME=COLUMN", help="Column that is kept as a covariate."),
    click.option(
        "--unit",
        "units",
        multiple=True,
        metavar="[QUANTITY=]UNIT",
        help="Unit of all lengths, angles … (--unit mm), or of one quantity (--unit deviation=um). A unit in brackets "
        "in the column's name, as in `X [mm]`, counts too.",
    ),
    click.option(
        "--value",
        "values",
        multiple=True,
        metavar="QUANTITY=VALUE",
        help="A quantity that is the same in every row, as in z=120mm or dir_x=1.",
    ),
    click.option(
        "--separator",
        help="A character, or comma, semicolon, tab, bar, space; by default that of the first four in the header.",
    ),
    click.option(
        "--decimal",
        type=click.Choice(["point", "comma"]),
        help="Decimal mark; by default the one that the numbers have where commas do not separate them.",
    ),
    click.option("--encoding", help="Of the text: utf-8 or utf-16, which are told apart by default, latin-1, cp1252 …"),
    click.option("--skip", type=click.IntRange(min=0), help="Lines before the header."),
    click.option(
        "--skip-after-header", type=click.IntRange(min=0), help="Lines after the header, such as one of units."
    ),
    click.option("--no-header", is_flag=True, help="No line names the columns; they are called 1, 2, 3 …"),
    click.option("--comment", metavar="TEXT", help="Lines that begin with this are left out."),
    click.option(
        "--missing", multiple=True, metavar="TEXT", help="Text that stands for no value, beside the empty cell."
    ),
    click.option(
        "--time-format",
        metavar="FORMAT",
        help="Of time stamps, such as '%m/%d/%Y %H:%M:%S'; not needed for 2024-05-03 10:15:00, 3.5.2024 10:15:00 and "
        "times of day.",
    ),
    click.option(
        "--sign",
        type=click.Choice(["actual-minus-nominal", "nominal-minus-actual"]),
        help="Sign of deviations in the table; actual minus nominal by default.",
    ),
    click.option("--origin", multiple=True, metavar="AXIS=LENGTH", help="Of nominal coordinates in the machine's."),
    click.option(
        "--align",
        is_flag=True,
        help="points: shift and turn the measured points of each setup onto the nominal ones, as a tracker's need.",
    ),
    click.option("--axis", type=click.Choice(["x", "y", "z"]), help="iso230-2: the axis that was moved."),
    click.option(
        "--actual", is_flag=True, help="iso230-2: the columns of the runs hold actual positions instead of deviations."
    ),
    click.option(
        "--senses", type=click.Choice(["x", "y", "z"]), help="iso230-2: the direction read, if not along the axis."
    ),
    click.option("--long", is_flag=True, help="iso230-2: a row for each reading, as with a column of directions."),
    click.option("--transposed", is_flag=True, help="iso230-2: a row for each run, the positions in the header."),
    click.option(
        "--up",
        multiple=True,
        metavar="NAME",
        help="iso230-2: column (or row) of a run up, in order; otherwise by names such as `1 up`.",
    ),
    click.option("--down", multiple=True, metavar="NAME", help="iso230-2: column (or row) of a run down, in order."),
    click.option(
        "--station", "stations", multiple=True, metavar="ID=X,Y,Z UNIT", help="ranges: where a station stands."
    ),
    click.option(
        "--target", "targets", multiple=True, metavar="ID=X,Y,Z UNIT", help="ranges: a target on a rotary table."
    ),
    click.option("--setup", "setup_name", metavar="ID", help="Name of the setup; the file's name by default."),
    click.option(
        "--trust-units",
        is_flag=True,
        help="Take numbers as they are that look like another unit, frame or order; the session says so "
        "(trust_units: true), and is read and identified without such refusals.",
    ),
    click.option("--chain", metavar="CHAIN", help="The machine, such as w-Y-X-b-Z-t."),
    click.option("--uncertainty", metavar="LENGTH", help="Standard uncertainty (k = 1) of one reading, such as 1.5um."),
    click.option("--datum", type=click.Choice(["none", "offset", "rigid"]), help="What is unknown of each setup."),
    click.option(
        "--instrument",
        metavar="NAME",
        help="What read, such as laser_interferometer, cmm or indicator; without it no effects of a beam in air.",
    ),
    click.option(
        "--term", "terms", multiple=True, metavar="NAME", help="Machine error to identify, such as EXX or C0Y."
    ),
)


def only_form(given: dict[str, Any]) -> bool:
    """Whether nothing is said of a foreign table but how its text is written, and that its sizes are right."""
    return not any(value for key, value in given.items() if key not in (*_FORM, "decimal", "no_header", "trust_units"))


def file_form(given: dict[str, Any]) -> dict[str, Any]:
    """What the options say of how a table's text is written."""
    form = {key: given[key] or None for key in _FORM}
    form["decimal"] = {"comma": ",", "point": "."}.get(given["decimal"] or "")
    form["header"] = False if given["no_header"] else None
    return {key: value for key, value in form.items() if value is not None}


def mapping_from(given: dict[str, Any], description: Path | None = None) -> tuple[dict[str, Any], str]:
    """The content of a mapping, and its name for messages: the file, with a session.yaml and the options over it.

    A UsageError if an option is not of its form; a CalibrationError if the file cannot be read.
    """
    from machine_tool_calibration.importing.mapping import FORMAT, read_mapping
    from machine_tool_calibration.session.text import read_yaml

    path = given["mapping"]
    content: dict[str, Any] = {} if path is None else dict(read_mapping(path))
    content.setdefault("format", FORMAT)
    for key in ("columns", "extras", "values", "origin", "stations", "targets"):
        _update(content, key, _pairs(key, given[key]), path)
    _update(content, "units", _units(given["units"]), path)
    _update(content, "file", file_form(given), path)
    content |= {key: given[key] for key in ("table", "sign", "axis", "senses") if given[key]}
    content |= {key: True for key in ("align", "transposed", "actual") if given[key]}
    if given["long"]:
        content["layout"] = "long"
    if given["up"] or given["down"]:
        pairs = zip_longest(given["up"], given["down"])
        content["runs"] = [
            {"column": name, "direction": direction}
            for pair in pairs
            for name, direction in zip(pair, ("up", "down"), strict=True)
            if name is not None
        ]
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
        _refuse_otherwise(content.get("session"), said, str(path), str(description))
        _update(content, "session", said, path)
    _update(content, "session", {key: value for key, value in session.items() if value is not None}, path)
    return content, "command line" if path is None else str(path)


def _refuse_otherwise(before: Any, said: dict[str, Any], path: str, description: str) -> None:
    """Refuse what a mapping's `session` and a session.yaml both say, and not the same."""
    both = [key for key in said if isinstance(before, dict) and key in before and before[key] != said[key]]
    if both:
        raise CalibrationError(
            f"{path}: session says {', '.join(both)} otherwise than --description {description}: say it in one"
        )


def _update(content: dict[str, Any], key: str, more: dict[str, Any], path: Path | None) -> None:
    before = content.get(key, {})
    if not isinstance(before, dict):
        raise CalibrationError(f"{path}: {key} must be a mapping of keys")
    if key == "session" and isinstance(before.get("machine"), dict) and "machine" in more:
        more = {**more, "machine": {**before["machine"], **more["machine"]}}
    if before or more:
        content[key] = {**before, **more}


def _pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    out = {}
    for text in texts:
        name, mark, value = text.partition("=")
        if not mark or not name.strip() or not value.strip():
            raise click.UsageError(f"--{option.rstrip('s')} {text!r} is not of the form NAME=…")
        out[name.strip()] = value.strip()
    return out


def _units(texts: Sequence[str]) -> dict[str, str]:
    from machine_tool_calibration.importing.units import dimension

    out = {}
    for text in texts:
        name, mark, unit = (part.strip() for part in text.rpartition("="))
        out[name if mark else dimension(unit)] = unit
    return out
