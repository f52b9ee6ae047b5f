# SPDX-License-Identifier: Apache-2.0
"""Every number that an identification publishes, in one vector: values and standard uncertainties.

A budget and a conformity ask what other readings would change of them, whatever the method's map holds.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.coverage import K
from machine_tool_calibration.errors import CalibrationError, ModelError, did_you_mean
from machine_tool_calibration.machine.error_motions import ERROR_MOTIONS
from machine_tool_calibration.methods.ball_bar.iso230_4 import circular_tests
from machine_tool_calibration.methods.ball_bar.model import CircleModel
from machine_tool_calibration.methods.fitted import FittedSessions
from machine_tool_calibration.methods.iso230_2 import positioning_runs
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.model import Kind
from machine_tool_calibration.model.result import ErrorMap
from machine_tool_calibration.words import say

POSITION_ERROR = "position_error"
FIGURES = ("B", "B_mean", "R", "R_up", "R_down", "E", "E_up", "E_down", "M", "A", "A_up", "A_down")
"""Figures of ISO 230-2:2014, of each axis (`A_X`)."""
DIAGONAL_FIGURES = {"E_D": "E", "E_D_up": "E_up", "E_D_down": "E_down", "B_D": "B"}
"""Figures of ISO 230-6:2002 with those of one diagonal, as of an axis, that they are (`E_D_PPP`)."""

CIRCULAR_FIGURES = ("G_ccw", "G_cw", "G_b", "H", "F_max_ccw", "F_max_cw", "F_min_ccw", "F_min_cw", "D")
"""Figures of ISO 230-4:2005, of each setup where there are several (`G_b.XY`)."""
SIGNED = ("B_mean", "F_max_ccw", "F_max_cw", "F_min_ccw", "F_min_cw", "D")
"""Figures of which a tolerance is for the absolute value."""

_OF_AXIS, _OF_DIAGONAL, _OF_CIRCLE = ("|".join(names) for names in (FIGURES, DIAGONAL_FIGURES, CIRCULAR_FIGURES))
_FIGURE = re.compile(rf"(?:({_OF_AXIS})_[XYZ]|({_OF_DIAGONAL})_[PN0]{{3}}|({_OF_CIRCLE}))(?:\..*)?")
_ANGULAR = re.compile(r"(E[ABC][XYZABC]|[ABC]0[XYZABC])\b.*|[xyz]_angular")


@dataclass(frozen=True)
class Quantity:
    """Numbers that are published under one name."""

    name: str  # `position_error`, an error motion, a squareness, a figure of a standard with its axis, an unknown
    unit: str  # m, rad or another one of SI
    first: int  # place of its first number in the vector
    count: int  # of its numbers
    where: Callable[[int], str]  # of the k-th number, in words; empty where there is only one
    at: Array | None = None  # (count,) position of each on its axis, m or rad, of an error motion; None of others
    figure: str | None = None  # which figure of a standard it is, of the readings without a model; None of others

    @property
    def members(self) -> slice:
        """Its numbers in the vector."""
        return slice(self.first, self.first + self.count)


@dataclass(frozen=True)
class Numbers:
    """All of them."""

    value: Array  # (M,) NaN where not determined
    u: Array  # (M,) standard uncertainty
    quantities: tuple[Quantity, ...]  # what is where

    @cached_property
    def by_name(self) -> dict[str, Quantity]:
        """The quantities by name."""
        return {q.name: q for q in self.quantities}

    def quantity(self, name: str) -> Quantity:
        """One of them; a ModelError: not published."""
        if name not in self.by_name:
            listed = [q.name for q in self.quantities if q.count > 1] or [q.name for q in self.quantities]
            near = did_you_mean(name, self.by_name) or f"; there are {', '.join(listed[:8])} …"
            raise ModelError(f"{name!r} is not published of this measurement{near}")
        return self.by_name[name]


@dataclass(frozen=True)
class _Entry:
    name: str
    unit: str
    value: Array
    u: Array
    where: Callable[[int], str]
    at: Array | None = None
    figure: str | None = None


def everything(fitted: FittedSessions) -> Numbers:
    """What is published of sessions: of the fit, then figures of the standards."""
    return _listed([*_of_fit(fitted, fitted.joint), *_of_readings(fitted)])


def check_names(fitted: FittedSessions, names: Sequence[str]) -> None:
    """Refuse names under which nothing is published, before anything is worked out; a ModelError if there is one."""
    if names:
        published = everything(fitted)
        for name in names:
            published.quantity(name)


def numbers(fitted: FittedSessions, joint: JointFit) -> Numbers:
    """What is published of the sessions' fit, or of a restated one of the same models."""
    return _listed(_of_fit(fitted, joint))


def iso_numbers(fitted: FittedSessions, shifts: Sequence[Array]) -> Numbers:
    """Figures of the standards when (n,) shifts, m, are added to each session's readings, without uncertainty."""
    return _listed(_of_readings(fitted, shifts))


def of_document(document: Mapping[str, Any]) -> Numbers:
    """What a result document says of map, motions and unknowns; a CalibrationError: an uncertainty that is none."""
    content, entries = document.get("error_map") or {}, list[_Entry]()
    if POSITION_ERROR in content:
        value, u = (np.asarray(content[key], dtype=np.float64) for key in (POSITION_ERROR, f"{POSITION_ERROR}_u"))
        filled = [np.pad(a, ((0, 0), (0, 3 - a.shape[1])), constant_values=np.nan).reshape(-1) for a in (value, u)]
        entries.append(_Entry(POSITION_ERROR, "m", filled[0], filled[1], _nowhere))
    entries += _content(content)
    tables: dict[str, list[Mapping[str, Any]]] = {}
    for one in document.get("parameters", ()):
        tables.setdefault(one["error_motion"] if "error_motion" in one else one["name"], []).append(one)
    for name, table in tables.items():
        value, u = (np.array([one[key] for one in table]) for key in ("value", "standard_uncertainty"))
        at = [one["position"] for one in table] if "error_motion" in table[0] else None
        where = partial(_at, name, at, 1) if at is not None and len(at) > 1 else _nowhere
        entries.append(_Entry(name, table[0]["unit"], value, u, where, _positions(at, len(table))))
    for entry in entries:
        u = np.asarray(entry.u, dtype=np.float64)
        wrong = np.isfinite(np.asarray(entry.value, dtype=np.float64)) & ~(np.isfinite(u) & (u >= 0.0))
        if wrong.any():
            k = int(wrong.argmax())
            raise CalibrationError(f"{entry.name}, value {k + 1}: {u[k]:g} is no standard uncertainty")
    return _listed(entries)


def _listed(entries: Iterable[_Entry]) -> Numbers:
    """Entries one after the other; of those of one name the first."""
    kept: dict[str, _Entry] = {}
    for entry in entries:
        if len(entry.value):
            kept.setdefault(entry.name, entry)
    first = np.cumsum([0, *(len(e.value) for e in kept.values())]).tolist()
    quantities = tuple(
        Quantity(e.name, e.unit, at, len(e.value), e.where, e.at, e.figure)
        for at, e in zip(first, kept.values(), strict=False)
    )
    value = np.concatenate([np.zeros(0), *(e.value for e in kept.values())])
    u = np.concatenate([np.zeros(0), *(e.u for e in kept.values())])
    return Numbers(value, np.where(np.isfinite(value), u, np.nan), quantities)


def _of_fit(fitted: FittedSessions, joint: JointFit) -> Iterator[_Entry]:
    error_map = fitted.map_of(joint)
    yield _position_error(error_map)
    yield from _content(error_map.content)
    for one in error_map.content.get("iso230_7", ()):
        value, u = np.array([one["value"]]), np.array([one["U"] / K])
        yield _Entry(f"{one['motion']}_range", one["unit"], value, u, _nowhere)
    yield from _unknowns(joint, error_map)


def _of_readings(fitted: FittedSessions, shifts: Sequence[Array] | None = None) -> Iterator[_Entry]:
    """Figures of ISO 230-2, ISO 230-4 and ISO 230-6 of a session, which its readings give without a model.

    With the standard uncertainty that follows from the repeatability of the runs, or the noise of the circles, unless
    the readings are shifted; none for several sessions, which have no such figures.
    """
    content = fitted.error_map.content
    if fitted.common is not None or not content.keys() & {"iso230_2", "iso230_6", "figures"}:
        return
    model = fitted.joint.assembly.models[0]
    observed = model.observations
    if shifts is not None:
        moved = replace(observed.readings, displacement=observed.readings.displacement + shifts[0])
        observed = replace(observed, readings=moved)
    if isinstance(model, CircleModel):
        exact = np.zeros(len(observed))
        tests = content["figures"] if shifts is None else circular_tests(observed, model.second_order, exact)[0]
        known = [one for one in tests if one["name"] in CIRCULAR_FIGURES]
        several = len({one["setup"] for one in known}) > 1
        for one in known:
            name = f"{one['name']}.{one['setup']}" if several else one["name"]
            yield _figure(name, one["name"], one["value"], one["U"] / K)
    for diagonals, figures in ((False, dict(zip(FIGURES, FIGURES, strict=True))), (True, DIAGONAL_FIGURES)):
        if ("iso230_6" if diagonals else "iso230_2") not in content:
            continue
        runs = positioning_runs(observed, diagonals=diagonals, uncertain=shifts is None)
        axes = [run["axis"] for run in runs]
        for run in runs:
            suffix = run["axis"] if axes.count(run["axis"]) == 1 else f"{run['axis']}.{run['setup']}"
            for name, figure in figures.items():
                yield _figure(f"{name}_{suffix}", name, run[figure], run.get(f"{figure}_U", np.nan) / K)


def _figure(name: str, figure: str, value: float, u: float) -> _Entry:
    return _Entry(name, "m", np.array([value]), np.array([u]), _nowhere, figure=figure)


def unit_of(name: str) -> str:
    """Of an error motion, a squareness, a figure or a part of a map: m, or rad where it is an angle."""
    return "rad" if _ANGULAR.fullmatch(name) else "m"


def figure_of(name: str) -> str | None:
    """Figure of a standard that a name such as `A_X`, `B_mean_X.second`, `E_D_PPP` or `G_b.XY` asks for; or None."""
    match = _FIGURE.fullmatch(name)
    return (match[1] or match[2] or match[3]) if match else None


def _nowhere(k: int) -> str:
    return ""


def _position_error(error_map: ErrorMap) -> _Entry:
    def where(k: int) -> str:
        place = ", ".join(f"{1e3 * v:.6g}" for v in error_map.points[k // 3])
        return say("budget.along_at", axis="xyz"[k % 3], place=place)

    return _Entry(POSITION_ERROR, "m", error_map.error.reshape(-1), error_map.uncertainty.reshape(-1), where)


def _content(content: Mapping[str, Any], nodes: Any = None, name: str = "") -> Iterator[_Entry]:
    """Every `name` with its `name_u`, also of tables and groups within."""
    for key, value in content.items():
        if isinstance(value, Mapping):
            yield from _content(value, value.get("nodes"), key)
        if f"{key}_u" not in content or key == POSITION_ERROR:
            continue
        # What is not determined as a whole is None.
        number, u = (np.asarray(content[k], dtype=np.float64).reshape(-1) for k in (key, f"{key}_u"))
        shown = name if key == "value" else key
        at = content.get(shown[2].lower()) if nodes is None and shown in ERROR_MOTIONS else nodes
        shape = np.shape(value)
        where = partial(_at, shown, at, shape[1] if len(shape) > 1 else 1) if len(number) > 1 else _nowhere
        yield _Entry(shown, unit_of(shown), number, u, where, _positions(at, len(number)))


def _positions(nodes: Any, count: int) -> Array | None:
    """Nodes as numbers; None where there are none, or names of setups."""
    if nodes is None or len(nodes) != count or any(isinstance(node, str) for node in nodes):
        return None
    return np.asarray(nodes, dtype=np.float64)


def _at(name: str, nodes: Any, width: int, k: int) -> str:
    """Where the k-th number of a table is."""
    if nodes is None or len(nodes) * width <= k:
        entry = say("budget.entry", n=k // width)
        return say("budget.component", entry=entry, n=k % width) if width > 1 else entry
    node = nodes[k // width]
    place = f"{np.degrees(node):.6g}°" if name[-1] in "ABC" else f"{1e3 * node:.6g} mm"
    return say("check.at", place=node if isinstance(node, str) else place)


def _unknowns(joint: JointFit, error_map: ErrorMap) -> Iterator[_Entry]:
    """The machine's error motions that are unknowns, as tables, then every unknown by its name, as it is published."""
    published, good = joint.published, joint.published.determined
    sigma = np.sqrt(np.maximum(np.diag(published.covariance), 0.0))
    nodes: dict[str, list[int]] = {}
    for k, parameter in enumerate(joint.assembly.parameters):
        if parameter.kind is Kind.MOTION and parameter.shared:
            nodes.setdefault(parameter.owner, []).append(k)
    for owner, index in nodes.items():
        at = [joint.assembly.parameters[k].at for k in index]
        table = np.where(good[index], published.theta[index], np.nan)
        where = partial(_at, owner, at, 1) if len(index) > 1 else _nowhere
        yield _Entry(owner, unit_of(owner), table, sigma[index], where, _positions(at, len(index)))
    hidden = frozenset().union(*(model.declared for model in joint.assembly.models))
    for k, parameter in enumerate(joint.assembly.parameters):
        if parameter.name in hidden or parameter.kind is Kind.POINTS:
            continue
        value, u = error_map.in_datum.get(parameter.name, (published.theta[k], sigma[k]))
        number = parameter.reference + value if good[k] else np.nan
        yield _Entry(parameter.name, parameter.unit, np.array([number]), np.array([u]), _nowhere)
