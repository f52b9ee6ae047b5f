# SPDX-License-Identifier: Apache-2.0
"""The options of `mtcal convert` for tables of other programs, and the mapping that they make."""

from collections.abc import Callable, Iterator, Sequence
from importlib import resources
from itertools import zip_longest
from pathlib import Path
from typing import Any

import click
import yaml

from machine_tool_calibration.cli.shared import FILE, options
from machine_tool_calibration.errors import CalibrationError

_FORM = ("separator", "encoding", "skip", "skip_after_header", "comment", "missing", "time_format")
"""Options of how the text of a table is written, but for those that are given in other words."""

_KINDS = {"file": FILE, "count": click.IntRange(min=0)}


def _declared() -> Iterator[Callable[[Any], Any]]:
    table = resources.files("machine_tool_calibration.cli") / "foreign_options.yaml"
    for flag, entry in yaml.safe_load(table.read_text(encoding="utf-8")).items():
        name = [entry.pop("name")] if "name" in entry else []
        kind = click.Choice(entry.pop("choice")) if "choice" in entry else _KINDS.get(entry.pop("kind", ""))
        yield click.option(flag, *name, type=kind, **entry)


foreign_options = options(*_declared())


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
        before = content.get("session")
        both = [key for key in said if isinstance(before, dict) and key in before and before[key] != said[key]]
        if both:
            names = ", ".join(both)
            raise CalibrationError(
                f"{path}: session says {names} otherwise than --description {description}: say it in one"
            )
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
