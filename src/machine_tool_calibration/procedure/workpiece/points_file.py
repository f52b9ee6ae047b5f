# SPDX-License-Identifier: Apache-2.0
"""Points of a workpiece as files: a table, entries for `session.yaml`, or put into a procedure."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from machine_tool_calibration.errors import SessionError
from machine_tool_calibration.procedure.description import parse_procedure, read_procedure
from machine_tool_calibration.procedure.workpiece.description import workpiece_entries
from machine_tool_calibration.session.catalogue import method_spec
from machine_tool_calibration.session.description import WorkpiecePoint
from machine_tool_calibration.session.text import read_text
from machine_tool_calibration.session.yaml_text import load_yaml

__all__ = ["points_csv", "points_yaml", "procedure_with"]

_LARGEST = 64 << 20


class _Flow(dict[str, Any]):
    """Written in one line."""


class _Dumper(yaml.SafeDumper):
    """Points in one line each."""


def _list(dumper: yaml.SafeDumper, data: list[Any]) -> yaml.Node:
    """Lists of numbers in one line."""
    short = all(isinstance(entry, int | float) for entry in data)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=short)


_Dumper.add_representer(list, _list)
_Dumper.add_representer(_Flow, lambda dumper, data: dumper.represent_mapping("tag:yaml.org,2002:map", data, True))


def points_csv(points: Sequence[WorkpiecePoint]) -> str:
    """A table with the columns id, feature, x, y, nx, ny; m."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["id", "feature", "x", "y", "nx", "ny"])
    rows.writerows([p.id, p.feature, *p.position, *p.normal] for p in points)
    return text.getvalue()


def points_yaml(points: Sequence[WorkpiecePoint]) -> str:
    """The key `workpiece` of a session."""
    return _dumped(_workpiece(points))


def procedure_with(file: Path, points: Sequence[WorkpiecePoint]) -> str:
    """A procedure's text with these points as its workpiece; comments are lost.

    Raises:
        SessionError: the file is no procedure of probing, or does not allow these points.
    """
    if not method_spec(read_procedure(file).session.method).probes_surface:
        raise SessionError(f"{file}: is no procedure of probing, which alone has a workpiece")
    content = dict(load_yaml(read_text(file, _LARGEST), str(file)).value)
    content["session"] = {**content["session"], **_workpiece(points)}
    text = _dumped(content)
    parse_procedure(text, str(file))
    return text


def _workpiece(points: Sequence[WorkpiecePoint]) -> dict[str, Any]:
    return {"workpiece": [_Flow(entry) for entry in workpiece_entries(tuple(points))]}


def _dumped(content: dict[str, Any]) -> str:
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=1000, allow_unicode=True)
