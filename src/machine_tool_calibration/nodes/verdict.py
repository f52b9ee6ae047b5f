"""A diagnosis as diagnostic_msgs/DiagnosticArray: the verdict, then a status for every candidate."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray

from machine_tool_calibration.diagnosis.quantities import sizes_in_words
from machine_tool_calibration.diagnosis.verdict_words import verdict_words
from machine_tool_calibration.model.result import Estimate
from machine_tool_calibration.nodes.calculation import Diagnosed
from machine_tool_calibration.nodes.stamps import to_message
from machine_tool_calibration.nodes.status import Level, status

__all__ = ["in_words", "verdict_message"]

_UNKNOWN = "not determined"
_CANDIDATE = (
    "probability",
    "p_value",
    "delta_bic",
    "rms_before",
    "rms_after",
    "explained_rms",
    "cross_validated_gain",
    "map_change_rms",
    "plausible",
)


def in_words(done: Diagnosed) -> str:
    """The verdict in sentences."""
    return " ".join(verdict_words(done.found, done.changes, done.advice))


def verdict_message(stamp: int, done: Diagnosed) -> DiagnosticArray:
    """The message of topic `diagnosis`.

    Args:
        stamp: ROS time, ns.
        done: the diagnosis; its document's values are told as they are, in SI units.
    """
    level = Level.OK if done.found.verdict == "adequate" else Level.WARN
    message = DiagnosticArray(status=[status("verdict", level, in_words(done), dict(_verdict(done.content)))])
    message.header.stamp = to_message(stamp)
    titles = {r.name: r.candidate.effect.title for r in done.found.ranked if r.candidate.effect is not None}
    for rank, candidate in enumerate(done.content["candidates"], start=1):
        name = candidate["effect"]
        level = Level.WARN if name in done.found.accepted else Level.OK
        words = ": ".join(filter(None, (titles.get(name, name), _sizes(candidate))))
        message.status.append(status(name, level, words, {"rank": rank, **_candidate(done.content, candidate)}))
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
    return f"{sizes_in_words(sizes)} (k = 2)" if sizes else ""


def _told(value: object) -> object:
    return _UNKNOWN if value is None else value
