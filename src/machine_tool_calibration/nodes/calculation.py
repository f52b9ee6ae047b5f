# SPDX-License-Identifier: Apache-2.0
"""What the estimator calculates: from collected readings to the messages that it publishes.

They are made beside the node's own thread, too: a large result takes its time to become text. Every calculation raises
a CalibrationError where the readings do not allow it.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA, String
from visualization_msgs.msg import Marker, MarkerArray

from machine_tool_calibration.arrays import Array
from machine_tool_calibration.budget import complete
from machine_tool_calibration.diagnosis.compare import compare
from machine_tool_calibration.diagnosis.diagnose import Diagnosis
from machine_tool_calibration.effects.catalogue import own_effects
from machine_tool_calibration.errors import ModelError
from machine_tool_calibration.json_types import plain
from machine_tool_calibration.machine.error_motions import SQUARENESS
from machine_tool_calibration.maps import FIELDS
from machine_tool_calibration.methods.axis_tables import axis_tables
from machine_tool_calibration.methods.fitted import FitRequest
from machine_tool_calibration.model.result import ErrorMap, Estimate, Result
from machine_tool_calibration.nodes.ros.messages import Level, cloud, dated, point, status
from machine_tool_calibration.plots.style import round_down
from machine_tool_calibration.progress import Progress
from machine_tool_calibration.reports.comparison import comparison_document
from machine_tool_calibration.reports.diagnosis_document import diagnosis_document
from machine_tool_calibration.reports.improvement import improvement_document, improvement_words
from machine_tool_calibration.reports.quantities import micrometres, sizes_in_words
from machine_tool_calibration.reports.verdict import next_step, verdict_words
from machine_tool_calibration.session.collect import Reading, live_session

MOST_ARROWS = 2000
_COMPONENTS = ("EX", "EY", "EZ", "EA", "EB", "EC")
AXIS_FIELDS = ("axis", "position", *_COMPONENTS, *(f"u{name[1]}" for name in _COMPONENTS))
_ARROW_SHARE = 0.1  # length of the largest arrow, of the map's extent
_SURE, _UNSURE = (0.85, 0.15, 0.1), (0.55, 0.55, 0.55)


def axis_cloud(stamp: int, result: Result) -> PointCloud2:
    """The error motions of each linear axis, one row for each node.

    Fields, all float64: `axis` (0 X, 1 Y, 2 Z), `position` (m), `EX EY EZ` (m) and `EA EB EC` (rad) there, and their
    standard uncertainties `uX … uC`; NaN where not determined. A row whose position is NaN holds the squareness of that
    axis against those before it: EC of Y is C0Y, EB of Z is B0Z, EA of Z is A0Z. No rows: no tables.
    """
    try:
        tables = axis_tables(result)
    except ModelError:
        return cloud(stamp, {name: np.zeros(0) for name in AXIS_FIELDS})
    rows: dict[tuple[int, float], Array] = {}

    def enter(axis: int, position: float, component: str, value: float, spread: float) -> None:
        row = rows.setdefault((axis, position), np.full(12, np.nan))
        column = "XYZABC".index(component)
        row[column], row[column + 6] = value, spread

    constant = float("nan")  # one object, so that it is one key
    for table in tables.tables:
        axis = "XYZ".index(table.axis)
        for node, value, spread in zip(table.nodes.tolist(), table.value, table.uncertainty, strict=True):
            enter(axis, node, table.name[1], value, spread)
    for name in SQUARENESS:
        if name in tables.squareness:
            enter("XYZ".index(name[2]), constant, name[0], *tables.squareness[name])
    ordered = sorted(rows.items(), key=lambda item: (item[0][0], -np.inf if np.isnan(item[0][1]) else item[0][1]))
    content = np.array([[*key, *values] for key, values in ordered]).reshape(len(ordered), len(AXIS_FIELDS))
    return cloud(stamp, {name: content[:, k] for k, name in enumerate(AXIS_FIELDS)})


def arrows(stamp: int, error_map: ErrorMap, magnification: float = 0.0) -> MarkerArray:
    """The position errors as arrows, magnified; grey where the error is within its U (95 %).

    At most MOST_ARROWS of the points, evenly chosen. A first marker takes away the arrows of an earlier map; the last
    one says how much is magnified (0: a round number). A direction that is not determined counts as zero.
    """
    known = np.isfinite(error_map.error)
    some = np.flatnonzero(known.any(axis=1))
    chosen = some[np.linspace(0, len(some) - 1, min(len(some), MOST_ARROWS)).round().astype(int)]
    points = error_map.points[chosen]
    error = np.where(known, error_map.error, 0.0)[chosen]
    spread = np.where(known, error_map.uncertainty, 0.0)[chosen]
    length = np.linalg.norm(error, axis=1)
    size = float(np.ptp(error_map.points, axis=0).max()) if len(error_map.points) else 0.0
    size = size or 0.1
    scale = magnification or round_down(_ARROW_SHARE * size / max(float(length.max(initial=0.0)), 1e-9))
    array = MarkerArray(markers=[_marker(stamp, 0, Marker.ARROW, action=Marker.DELETEALL)])
    for k, (start, vector, sure) in enumerate(
        zip(points, scale * error, length > 2 * np.linalg.norm(spread, axis=1), strict=True)
    ):
        marker = _marker(stamp, k, Marker.ARROW, _SURE if sure else _UNSURE)
        marker.points = [point(start), point(start + vector)]
        marker.scale.x, marker.scale.y, marker.scale.z = 0.004 * size, 0.01 * size, 0.015 * size
        array.markers.append(marker)
    words = _marker(stamp, len(chosen), Marker.TEXT_VIEW_FACING, _UNSURE)
    words.text = f"errors x {scale:g}, largest {1e6 * float(length.max(initial=0.0)):.1f} um"
    words.pose.position = (
        point(np.append(points[:, :2].mean(axis=0), points[:, 2].max() + 0.1 * size)) if len(points) else Point()
    )
    words.scale.z = 0.04 * size
    array.markers.append(words)
    return array


def _marker(
    stamp: int, number: int, kind: int, color: tuple[float, float, float] = _UNSURE, *, action: int = Marker.ADD
) -> Marker:
    marker = Marker(ns="error_map", id=number, type=kind, action=action)
    marker.pose.orientation.w = 1.0
    marker.color = ColorRGBA(r=color[0], g=color[1], b=color[2], a=1.0)
    return dated(marker, stamp)


_UNKNOWN = "not determined"
_CANDIDATE = (
    "probability", "p_value", "delta_bic", "rms_before", "rms_after", "explained_rms",
    "cross_validated_gain", "map_change_rms", "plausible",
)  # fmt: skip


def verdict_message(stamp: int, found: Diagnosis, content: Mapping[str, Any], words: str) -> DiagnosticArray:
    """The message of topic `diagnosis`: the verdict's words, and values of the document as they are, in SI units."""
    level = Level.OK if found.verdict == "adequate" else Level.WARN
    message = DiagnosticArray(status=[status("verdict", level, words, dict(_verdict(content)))])
    dated(message, stamp, "")
    titles = {r.name: r.candidate.effect.title for r in found.ranked if r.candidate.effect is not None}
    for rank, candidate in enumerate(content["candidates"], start=1):
        name = candidate["effect"]
        level = Level.WARN if name in found.accepted else Level.OK
        told = ": ".join(filter(None, (titles.get(name, name), _sizes(candidate))))
        message.status.append(status(name, level, told, {"rank": rank, **_candidate(content, candidate)}))
    return message


def _verdict(content: Mapping[str, Any]) -> Iterator[tuple[str, object]]:
    before, after, noise = content["fit"]["before"], content["fit"]["after"], content["noise"]
    yield "verdict", content["verdict"]
    yield "accepted", ", ".join(content["accepted"])
    yield "observations", content["observations"]
    yield "outliers", ", ".join(str(outlier["row"]) for outlier in content["outliers"])
    yield "declared", _told(noise["declared"])
    yield "from_repeats", _told(noise["from_repeats"])
    for when, fit in (("before", before), ("after", after)):
        yield f"rms_{when}", _told(fit["rms_residual"])
        yield f"reduced_chi_square_{when}", _told(fit["reduced_chi_square"])


def _candidate(content: Mapping[str, Any], candidate: Mapping[str, Any]) -> dict[str, object]:
    name = candidate["effect"]
    alike = {other for group in content["alias_groups"] if name in group for other in group} - {name}
    entries: dict[str, object] = {"accepted": name in content["accepted"], "alike": ", ".join(sorted(alike))}
    entries |= {key: _told(candidate[key]) for key in _CANDIDATE}
    for parameter in candidate["parameters"]:
        own = parameter["name"]
        entries[own] = _told(parameter["value"])
        entries[f"{own} standard_uncertainty"] = _told(parameter["standard_uncertainty"])
        entries[f"{own} unit"] = parameter["unit"]
    return entries


def _sizes(candidate: Mapping[str, Any]) -> str:
    """Sizes with their expanded uncertainty, where they have one."""
    known = [p for p in candidate["parameters"] if None not in (p["value"], p["standard_uncertainty"])]
    sizes = [Estimate(p["name"], p["value"], p["standard_uncertainty"], p["unit"]) for p in known]
    return f"{sizes_in_words(sizes)} (95 %)" if sizes else ""


def _told(value: object) -> object:
    return _UNKNOWN if value is None else value


TOPICS: Mapping[str, Any] = {
    "error_map": PointCloud2,
    "error_map/axes": PointCloud2,
    "error_map/arrows": MarkerArray,
    "error_map/result": String,
    "residuals": PointCloud2,
    "comparison/result": String,
    "diagnosis": DiagnosticArray,
    "diagnosis/result": String,
    "improvement/result": String,
}
"""Type of what is published on each topic; all are latched."""


@dataclass(frozen=True)
class Request:
    """What to calculate from."""

    text: str  # the session's description
    readings: list[Reading]  # in the order of time
    model: str | None  # variant of the method's model; None for its default
    effects: tuple[str, ...]  # ids of the effects in the model
    files: tuple[str, ...]  # of the user's own effects
    magnification: float  # of errors as arrows; 0 for a round number
    now: Callable[[], int]  # gives the stamp of what is found, ns

    def chosen(self) -> FitRequest:
        """The readings as a session, and the model; raises where they do not make one yet, or as `own_effects`."""
        session = live_session(self.text, self.readings)
        return FitRequest((session,), None, self.model, self.effects, tuple(own_effects(self.files)))


@dataclass(frozen=True)
class Outcome:
    """What a calculation gave."""

    words: str  # a sentence about it
    values: Mapping[str, object]  # for programs, SI
    messages: Mapping[str, Any]  # to be published, by topic
    accepted: tuple[str, ...] | None = None  # effects that a diagnosis accepted; None if none was made
    effects: tuple[str, ...] | None = None  # of the model from now on; None where they stay


def identified(request: Request, progress: Progress) -> Outcome:
    """Fit the model: the map in all its forms, and the document `mtcal-result/1`."""
    progress("fitting the model", 0.0)
    result = complete.identify(request.chosen())
    assert isinstance(result, Result), "one session"
    values = {
        "observations": result.observations,
        "used": len(result.fit.residuals),
        "rms_residual": result.rms_residual,
        "reduced_chi_square": result.fit.joint.reduced_chi_square,
    }
    residual = f"{micrometres(result.rms_residual)} µm RMS residual"
    return Outcome(f"identified from {result.observations} readings: {residual}", values, _map(request, result))


def compared(request: Request, progress: Progress) -> Outcome:
    """Hold the readings against the fitted model: the document `mtcal-comparison/1`."""
    progress("comparing", 0.0)
    content = comparison_document(compare(request.chosen()))
    values = {name: content[name] for name in ("readings", "rms_residual", "reduced_chi_square", "p_value")}
    return Outcome(f"compared: {content['summary']}", values, {"comparison/result": _text(content)})


def diagnosed(request: Request, progress: Progress) -> Outcome:
    """Look for the effects that the model lacks: verdict, and the document `mtcal-diagnosis/1`."""
    found, then = complete.diagnose(request.chosen(), progress=progress)
    words, content, messages = _diagnosis(request, found, then)
    values = {
        "verdict": content["verdict"],
        "accepted": " ".join(content["accepted"]),
        "rms_before": content["fit"]["before"]["rms_residual"],
        "rms_after": content["fit"]["after"]["rms_residual"],
    }
    return Outcome(f"diagnosed: {words}", values, messages, accepted=tuple(content["accepted"]))


def improved(request: Request, progress: Progress) -> Outcome:
    """Diagnose, accept what is found, and identify again: all of both, and the document `mtcal-improvement/1`."""
    steps = complete.improve(request.chosen(), progress=lambda step, share: progress(step, complete.SEARCH * share))
    then = complete.conclude(steps.diagnosis, progress=progress)
    _, content, messages = _diagnosis(request, steps.diagnosis, then)
    first, last = steps.steps[0], steps.steps[-1]
    assert isinstance(last.result, Result), "one session"
    effects = tuple(last.result.effects)
    values = {
        "verdict": content["verdict"],
        "accepted": " ".join(steps.accepted),
        "effects": " ".join(effects),
        "set_aside": " ".join(str(row) for row in last.set_aside[0]),
        "rms_before": first.result.rms_residual,
        "rms_after": last.result.rms_residual,
        "reduced_chi_square_before": first.reduced_chi_square,
        "reduced_chi_square_after": last.reduced_chi_square,
    }
    messages |= {**_map(request, last.result), "improvement/result": _text(improvement_document(steps))}
    words = [improvement_words(steps)]
    if steps.diagnosis.verdict == "unexplained":
        words.append(next_step(steps.diagnosis, then.advice))
    return Outcome(" ".join(words), values, messages, effects=effects)


def _map(request: Request, result: Result) -> dict[str, Any]:
    """An error map in all its forms, and the residuals, by topic."""
    found, stamp = result.error_map, request.now()
    columns = np.hstack([found.points, found.error, found.uncertainty]).T
    return {
        "error_map": cloud(stamp, dict(zip(FIELDS, columns, strict=True))),
        "error_map/axes": axis_cloud(stamp, result),
        "error_map/arrows": arrows(stamp, found, request.magnification),
        "error_map/result": _text(result.document()),
        "residuals": cloud(stamp, _residual_fields(result)),
    }


def _residual_fields(result: Result) -> dict[str, Array]:
    readings = result.fit.model.observations.readings
    position = readings.position()
    return {
        **{axis: position[:, index] for index, axis in enumerate("xyz")},
        "measured": readings.displacement,
        "predicted": result.fit.predicted,
        "residual": result.fit.residuals,
        "row": readings.row.astype(float),
        "setup": readings.setup.astype(float),
        "repeat": readings.repeat.astype(float),
    }


def _diagnosis(
    request: Request, found: Diagnosis, then: complete.Conclusions
) -> tuple[str, Mapping[str, Any], dict[str, Any]]:
    """The verdict in sentences, the document's content, and the messages."""
    words = " ".join((*verdict_words(found, then.changes, then.advice), next_step(found, then.advice)))
    content = diagnosis_document(found, then.advice, then.changes)
    verdict = verdict_message(request.now(), found, content, words)
    return words, content, {"diagnosis": verdict, "diagnosis/result": _text(content)}


def _text(content: Mapping[str, Any]) -> String:
    return String(data=json.dumps(plain(content), allow_nan=False, ensure_ascii=False))
