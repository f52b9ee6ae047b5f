# SPDX-License-Identifier: Apache-2.0
"""Tables of other programs that the tests of this folder read."""

from pathlib import Path
from typing import Any

from machine_tool_calibration.importing.build import Imported, import_table
from machine_tool_calibration.importing.mapping import parse_mapping

DATA = Path(__file__).parents[1] / "data" / "foreign"
SESSION = {"machine": {"chain": "w-Y-X-b-Z-t"}, "standard_uncertainty": "1um"}
RUNS = {"table": "iso230-2", "axis": "x", "session": {**SESSION, "machine": {"chain": "w-X-b-t"}}}
WIDE = {**RUNS, "columns": {"position": "Position [mm]"}, "units": {"deviation": "um"}}
GOOD = "X,M\n0,0.001\n100,100.002\n200,200.001\n"


def read(name: str, content: dict[str, Any], setup: str | None = None) -> Imported:
    return import_table(DATA / name, parse_mapping(content, "mapping"), name=setup)


def points(tmp_path: Path, text: str, **more: Any) -> Imported:
    file = tmp_path / "t.csv"
    file.write_text(text)
    content: dict[str, Any] = {
        "table": "points",
        "columns": {"x": "X", "actual_x": "M"},
        "units": {"length": "mm"},
        "session": SESSION,
    }
    for key, value in more.items():
        content[key] = value
    return import_table(file, parse_mapping(content, "mapping"))
