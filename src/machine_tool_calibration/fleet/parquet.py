# SPDX-License-Identifier: Apache-2.0
"""What was found of many sessions as Parquet files, which pandas and DuckDB read."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from machine_tool_calibration.files import whole
from machine_tool_calibration.fleet.each import Done
from machine_tool_calibration.fleet.machines import Machine, Machines
from machine_tool_calibration.fleet.sessions import Identified, Place
from machine_tool_calibration.reports.documents import picked

_RESULT = (
    "method", "model", "observations", "used", "rms_residual", "reduced_chi_square", "degrees_of_freedom", "p_value",
)  # fmt: skip
_EFFECTS = ("machine", "date", "session", "effect", "probability", "coefficient", "value", "u", "unit")
_CHANGE = ("probability", "change", "u")
# Columns of numbers, also where none is known.
_FLOAT = (
    "rms_residual", "reduced_chi_square", "p_value", "size_value", "size_u", "most_uncertain_u", "probability",
    "change", "u", "value", "value_u", "limit",
)  # fmt: skip


def identified_tables(found: Sequence[Done[Place, Identified]]) -> dict[str, pd.DataFrame]:
    """`sessions`, one a row with how well it fits or its problem, and `values`, everything that was found of them."""
    rows, values = [], []
    for one in sorted(found, key=lambda own: own.item):
        row: dict[str, Any] = {"session": one.item.label, "problem": one.problem}
        if one.found is not None:
            document = one.found.document
            row |= {name: document[name] for name in _RESULT}
            row |= {"effects": ",".join(document["effects"]), "sha256": document["provenance"]["sha256"]}
            values.append(one.found.values.assign(session=one.item.label))
        rows.append(row)
    columns = ["session", *_RESULT, "effects", "sha256", "problem"]
    whole = pd.concat(values, ignore_index=True) if values else pd.DataFrame({"session": pd.Series(dtype=str)})
    return {
        "sessions": _numbered(pd.DataFrame(rows, columns=columns)),
        "values": whole[["session", *(name for name in whole if name != "session")]],
    }


def machine_tables(fleet: Machines) -> dict[str, pd.DataFrame]:
    """`machines`, `sessions`, `sizes` of every session, `trends` of every number, `effects` that were found."""
    tables = {
        "machines": [_machine(one) for one in fleet.machines],
        "sessions": [row for one in fleet.machines for row in _sessions(one)],
        "sizes": [
            {"machine": one.name, "date": entry.date, "session": entry.label, **asdict(size)}
            for one in fleet.machines
            for entry in one.entries
            for size in entry.sizes
        ],
        "trends": [row for one in fleet.machines for row in _trends(one)],
        "effects": [row for one in fleet.machines for row in _effects(one)],
    }
    columns = {"effects": _EFFECTS}
    return {name: _numbered(pd.DataFrame(rows, columns=columns.get(name))) for name, rows in tables.items()}


def write_tables(tables: Mapping[str, pd.DataFrame], folder: Path) -> list[Path]:
    """Write each, wholly or not at all, as Parquet into a folder that may be missing; a CalibrationError: it cannot."""
    written = []
    for name, table in tables.items():
        written.append(folder / f"{name}.parquet")
        with whole(written[-1]) as part:
            table.to_parquet(part, index=False)
    return written


def _numbered(table: pd.DataFrame) -> pd.DataFrame:
    return table.astype({name: float for name in table if name in _FLOAT})


def _machine(one: Machine) -> dict[str, Any]:
    size, worst = one.size, one.uncertain
    return {
        "machine": one.name,
        "causes": ",".join(one.causes),
        "sessions": len(one.entries),
        "first_date": one.trend.dates[0],
        "last_date": one.trend.dates[-1],
        "verdict": one.diagnosis["verdict"] if one.diagnosis else "",
        "size": size.name if size else "",
        "size_value": size.value if size else None,
        "size_u": size.u if size else None,
        "most_uncertain": worst.name if worst else "",
        "most_uncertain_u": worst.u if worst else None,
    }


def _sessions(machine: Machine) -> Iterator[dict[str, Any]]:
    for entry, diagnosis in zip(machine.entries, machine.diagnoses, strict=True):
        yield {
            "machine": machine.name,
            "date": entry.date,
            "session": entry.label,
            "instrument": entry.instrument,
            **{name: entry.result.get(name) for name in _RESULT},
            "added": ",".join(entry.result.get("effects", ())),
            "verdict": diagnosis["verdict"] if diagnosis else "",
            "effects": ",".join(one["effect"] for one in diagnosis["effects"]) if diagnosis else "",
            "outliers": diagnosis["outliers"] if diagnosis else None,
            **picked(entry, "software", "sha256"),
        }


def _trends(machine: Machine) -> Iterator[dict[str, Any]]:
    for one in machine.trend.courses:
        told = one.explanation
        yield {
            "machine": machine.name,
            **picked(one, "name", "unit", "kind", "alarm", "suspected"),
            **(picked(told, *_CHANGE) if told else dict.fromkeys(_CHANGE)),
            "began_after": one.began[0] if one.changed else "",
            "began_before": one.began[1] if one.changed else "",
            "last_date": one.dates[-1],
            "value": float(one.value[-1]),
            "value_u": float(one.u[-1]),
            "limit": one.limit,
            "against_limit": one.against_limit or "",
        }


def _effects(machine: Machine) -> Iterator[dict[str, Any]]:
    for entry, diagnosis in zip(machine.entries, machine.diagnoses, strict=True):
        for one in diagnosis["effects"] if diagnosis else ():
            where = {"machine": machine.name, "date": entry.date, "session": entry.label}
            coefficients: Sequence[dict[str, Any]] = one["parameters"] or ({},)
            for coefficient in coefficients:
                yield {
                    **where,
                    "effect": one["effect"],
                    "probability": one["probability"],
                    "coefficient": coefficient.get("name", ""),
                    "value": coefficient.get("value"),
                    "u": coefficient.get("standard_uncertainty"),
                    "unit": coefficient.get("unit", ""),
                }
