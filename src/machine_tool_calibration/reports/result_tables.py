# SPDX-License-Identifier: Apache-2.0
"""A result as tables: the same columns whatever the method, NaN and a flag where the data does not determine a value.

SI units. `u…` are standard uncertainties (k = 1); an expanded uncertainty U (95 %) is twice as large. The columns are
described where people ask for them, at the attributes of `Fit` with these names.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from machine_tool_calibration.budget.published import DIAGONAL_FIGURES, FIGURES
from machine_tool_calibration.coverage import K
from machine_tool_calibration.machine.error_motions import SQUARENESS, parse_motion
from machine_tool_calibration.methods.identify import JointResult
from machine_tool_calibration.model.model import Kind
from machine_tool_calibration.model.result import Result
from machine_tool_calibration.reports.quantities import decimals, fixed
from machine_tool_calibration.reports.unknowns import named_in_words
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.description import Probing

# Decimals of a place, mm or degrees, and of what has no uncertainty; U below which it has none, um or urad.
_DECIMALS = 6
_NO_UNCERTAINTY = 1e-6


_Value = tuple[str, float, float, float]
"""Name of an error motion or a squareness, its position (of a squareness NaN), value and standard uncertainty."""


def error_map(result: Result | JointResult) -> pd.DataFrame:
    """Position errors, one place a row; first comes what the method says of the places besides where they are."""
    found = result.error_map
    columns: dict[str, Any] = {}
    if isinstance(result, Result):
        columns |= _places(result)
    known = np.isfinite(found.error) & np.isfinite(found.uncertainty)
    error, uncertainty = np.where(known, found.error, np.nan), np.where(known, found.uncertainty, np.nan)
    columns |= {axis: found.points[:, j] for j, axis in enumerate("xyz")}
    columns |= {f"e{axis}": error[:, j] for j, axis in enumerate("xyz")}
    columns |= {f"u{axis}": uncertainty[:, j] for j, axis in enumerate("xyz")}
    columns |= {f"determined_{axis}": known[:, j] for j, axis in enumerate("xyz")}
    return pd.DataFrame(columns)


def _places(result: Result) -> dict[str, Any]:
    """What a method says of the places of its map besides where they are."""
    content, session = result.error_map.content, result.fit.model.observations.session
    if "x_position" in content:
        return {"axis": np.repeat(list("xyz"), [len(content[axis]) for axis in "xyz"])}
    if spec_of(session).turns_one_axis:
        axis = session.description.machine.table_axis.lower()
        targets = content["target_ids"]
        return {"target": targets * len(content[axis]), axis: np.repeat(content[axis], len(targets))}
    points, approach = result.error_map.points, content.get("approach")
    if approach is None or len(np.unique(points, axis=0)) == len(points):
        return {}
    differ = np.flatnonzero(np.ptp(approach, axis=0))
    said = [" ".join(f"{'xyz'[j]}{'-0+'[int(row[j]) + 1]}" for j in differ) for row in approach]
    found: dict[str, Any] = {"approach": said} if len(differ) else {}
    if len(np.unique(np.hstack([points, approach]), axis=0)) < len(points):
        # in several states of time, temperature and the like, which stand where the reading does
        found["row"] = content["row"]
    return found


def error_motions(result: Result | JointResult) -> pd.DataFrame:
    """Error motions and squareness errors, one value a row; without rows where every point has errors of its own."""
    content = result.error_map.content
    if isinstance(result, JointResult):
        values = _tables({**content["tables"], **content.get("rotary", {})})
    else:
        values = _single(result)
    rows = []
    for motion, position, *found in values:
        single, known = motion in SQUARENESS, bool(np.isfinite(found).all())
        along = "" if single else "rad" if motion[2] in "ABC" else "m"
        unit = "rad" if single or parse_motion(motion).is_rotation else "m"
        rows.append((motion, position, along, *(found if known else (np.nan, np.nan)), unit, known))
    return pd.DataFrame(rows, columns=["motion", "position", "position_unit", "value", "u", "unit", "determined"])


def _single(result: Result) -> Iterator[_Value]:
    content, session = result.error_map.content, result.fit.model.observations.session
    if "tables" in content:
        yield from _tables(content["tables"])
    elif spec_of(session).turns_one_axis:
        axis = session.description.machine.table_axis
        for name in (f"E{component}{axis}" for component in "XYZABC"):
            yield from _curve(name, content[axis.lower()], content[name], content[f"{name}_u"])
    elif "x_position" in content:
        yield from _profiles(content)
    else:
        yield from _unknowns(result)


def _profiles(content: Mapping[str, Any]) -> Iterator[_Value]:
    """Of a step diagonal, in the coordinate system of its map."""
    for axis in "xyz":
        for j, component in enumerate("XYZ"):
            value, u = content[axis][:, j], content[f"{axis}_u"][:, j]
            yield from _curve(f"E{component}{axis.upper()}", content[f"{axis}_position"], value, u)
    found = content["squareness"]
    for name in SQUARENESS:
        if name in found:
            yield name, np.nan, found[name], found[f"{name}_u"]


def _tables(tables: Mapping[str, Any]) -> Iterator[_Value]:
    for name, table in tables.items():
        if "nodes" in table:
            yield from _curve(name, table["nodes"], table["value"], table["value_u"])
        else:
            yield name, np.nan, float(table["value"]), float(table["value_u"])


def _curve(name: str, position: Any, value: Any, u: Any) -> Iterator[_Value]:
    for at, found, spread in zip(position, value, u, strict=True):
        yield name, float(at), float(found), float(spread)


def _unknowns(result: Result) -> Iterator[_Value]:
    """Error motions among the model's unknowns, those of a rotary table at the angles of its setups."""
    known = {estimate.name: estimate for estimate in result.parameters}
    setups = result.fit.model.observations.session.description.setups
    angle = {setup.id: float(getattr(setup, "c", np.nan)) for setup in setups}
    for parameter in result.fit.model.parameters:
        if parameter.kind not in (Kind.MOTION, Kind.SQUARENESS):
            continue
        position = angle[parameter.at] if isinstance(parameter.at, str) else parameter.at
        estimate = known.get(parameter.name)
        value, u = (np.nan, np.nan) if estimate is None else (estimate.value, estimate.standard_uncertainty)
        yield parameter.owner, np.nan if position is None else position, value, u


def parameters(result: Result | JointResult, document: Mapping[str, Any]) -> pd.DataFrame:
    """Every unknown of the model, by name."""
    unknowns = result.joint.assembly.unknowns
    words = named_in_words(result.joint, document["effects"])
    rows: list[tuple[Any, ...]] = [
        (entry["name"], entry["value"], entry["standard_uncertainty"], entry["unit"], True, "")
        for entry in document["parameters"]
    ]
    for entry in document["not_determined"]:
        unit = unknowns[entry["name"]].unit if entry["name"] in unknowns else ""
        rows.append((entry["name"], np.nan, np.nan, unit, False, entry["why"]))
    table = pd.DataFrame(rows, columns=["name", "value", "u", "unit", "determined", "why_not"])
    table.insert(5, "meaning", [words.get(name, "") for name in table["name"]])
    return table.set_index("name")


def workpiece(result: Result | JointResult) -> pd.DataFrame:
    """Errors of a probed workpiece's points, by the point's id; without rows for other methods."""
    names = ["point", "x", "y", "nx", "ny", "error", "u", "determined", "form", "u_form", "form_determined"]
    description = result.fit.model.observations.session.description if isinstance(result, Result) else None
    if not isinstance(description, Probing):
        return pd.DataFrame(columns=names).set_index("point")
    content = result.error_map.content
    frame = pd.DataFrame({"point": content["workpiece_points"]})
    place = {point.id: (*point.position[:2], *point.normal[:2]) for point in description.workpiece}
    frame[["x", "y", "nx", "ny"]] = [place[point] for point in content["workpiece_points"]]
    for name, key, u, flag in (
        ("error", "workpiece_error", "u", "determined"),
        ("form", "workpiece_form", "u_form", "form_determined"),
    ):
        frame[name], frame[u] = content[key], content[f"{key}_u"]
        frame[flag] = frame[[name, u]].notna().all(axis=1)
        frame.loc[~frame[flag], [name, u]] = np.nan
    return frame[names].set_index("point")


def _standards(result: Result | JointResult) -> pd.DataFrame:
    """Figures of ISO 230-2 and ISO 230-6 of every run (`A_X`, `E_D_PPP`), and of ISO 230-7 (`EXC_range`)."""
    content = result.error_map.content
    runs = [(run, {name: name for name in FIGURES}) for run in content.get("iso230_2", ())]
    runs += [(run, DIAGONAL_FIGURES) for run in content.get("iso230_6", {}).get("runs", ())]
    rows = [
        (f"{name}_{run['axis']}", run["setup"], run[figure], run.get(f"{figure}_U", np.nan) / K, "m")
        for run, figures in runs
        for name, figure in figures.items()
    ]
    rows += [(f"{o['motion']}_range", None, o["value"], o["U"] / K, o["unit"]) for o in content.get("iso230_7", ())]
    rows += [(o["name"], o["setup"], o["value"], o["U"] / K, o["unit"]) for o in content.get("figures", ())]
    found = pd.DataFrame(rows, columns=["error", "setup", "value", "u", "unit"]).astype({"value": float, "u": float})
    found["determined"] = np.isfinite(found["value"]) & np.isfinite(found["u"])
    found.loc[~found["determined"], ["value", "u"]] = np.nan
    return found if found["setup"].nunique() > 1 else found.drop(columns="setup")


_TIDY = ("error", "position", "position_unit", "x", "y", "z", "value", "u", "U", "unit", "determined")


def tidy(result: Result | JointResult) -> pd.DataFrame:
    """All that was found of the machine and the part in one table, one value a row.

    `error` is an error motion or squareness (EXX, C0Y, …) at `position` on its axis in `position_unit`, or the position
    error `ex`, `ey`, `ez` at the place `x y z` (m), or `workpiece_error` of a probed `point` along its normal, or a
    figure of ISO 230 (`A_X`, `E_D_PPP`, `EXC_range`; of several runs with its `setup`); further columns as `error_map`
    has them. `value`, standard uncertainty `u` and expanded uncertainty `U` (k = 2) in `unit`; `determined`: where
    False, they are NaN.
    """
    places = error_map(result)
    own = [name for name in map(str, places) if name in ("axis", "target", "approach", "row", "a", "b", "c")]
    frames = [error_motions(result).rename(columns={"motion": "error"})]
    for axis in "xyz":
        known = {"value": places[f"e{axis}"], "u": places[f"u{axis}"], "determined": places[f"determined_{axis}"]}
        frames.append(places[[*own, "x", "y", "z"]].assign(error=f"e{axis}", unit="m", **known))
    part = workpiece(result).reset_index()
    if len(part):
        kept = part[["point", "x", "y", "u", "determined"]]
        frames.append(kept.assign(error="workpiece_error", unit="m", value=part["error"]))
    frames.append(_standards(result))
    whole = pd.concat([frame for frame in frames if len(frame)], ignore_index=True)
    whole["U"] = K * whole["u"]
    return whole.reindex(columns=[_TIDY[0], *(name for name in whole if name not in _TIDY), *_TIDY[1:]])


def in_shop_units(table: pd.DataFrame) -> pd.DataFrame:
    """A table of `tidy` with places in mm and degrees, errors in um and urad, rounded to what U allows.

    U keeps two figures and the value as many decimals, trailing zeros with them; `u` one more.
    """
    out = table.astype({name: object for name in ("position", "value", "u", "U")})
    turned = table["position_unit"] == "rad"
    out["position"] = np.where(turned, np.degrees(table["position"]), 1e3 * table["position"])
    out["position_unit"] = table["position_unit"].replace({"rad": "deg", "m": "mm"})
    for name in table.columns.intersection([*"xyzabc"]):
        out[name] = (1e3 * table[name] if name in "xyz" else np.degrees(table[name])).round(_DECIMALS)
    out["position"] = out["position"].astype(float).round(_DECIMALS)
    for k, U in enumerate(1e6 * table["U"]):
        for name, more in (("value", 0), ("u", 1), ("U", 0)):
            found = 1e6 * table[name].iloc[k]
            exact = not U > _NO_UNCERTAINTY
            out.loc[out.index[k], name] = round(found, _DECIMALS) if exact else fixed(found, decimals(U) + more)
    out["unit"] = "u" + table["unit"]
    return out
