# SPDX-License-Identifier: Apache-2.0
"""What is said of a fit: how its readings scatter, and what the coefficients of its effects leave open."""

from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import rms
from machine_tool_calibration.coverage import K
from machine_tool_calibration.effects.pitch_periodic import aliases
from machine_tool_calibration.model.fit import JointFit
from machine_tool_calibration.model.observations import SAME_POSITION
from machine_tool_calibration.model.result import (
    effect_estimates,
    fit_quality,
    lacks_reversal,
    one_direction,
    only_if_right,
    scatter_p_value,
)
from machine_tool_calibration.model.widening import BESIDE
from machine_tool_calibration.reports.quantities import MOST_NAMED, probability, quantity, rounded
from machine_tool_calibration.reports.quantities import p_value as chance
from machine_tool_calibration.residuals.scatter import scatter_change
from machine_tool_calibration.session.catalogue import method_spec
from machine_tool_calibration.words import Said, Verbatim, enumeration, say, together

_SURE = 2.0  # standard uncertainties below zero from which a coefficient is negative
_VAGUE = 0.01  # share of the places' extent from which an expanded uncertainty tells nothing of a machine
_WEAK = 3.0  # uncertainty over that of single readings from which it is the geometry that hardly determines a map
_FAR_OFF = 2.0  # standard uncertainties of most places from which what readings are together off the map stands out


def fit_words(reduced_chi_square: float, p_value: float, content: Mapping[str, Any]) -> Said:
    """How well a model fits: the scatter of the readings against their declared uncertainty, in a sentence."""
    if direct := scatter_words(content, p_value):
        return direct
    how, ratio = fit_quality(p_value), rounded(reduced_chi_square**0.5)
    return together((say(f"fit.{how.replace(' ', '_')}", ratio=ratio, p=chance(p_value)), *_each_words(content)))


def _scatter_words(content: Mapping[str, Any], p_value: float) -> Said | None:
    """How the readings scatter, what was declared, and which of them the uncertainties use; None for other methods."""
    scatter = content.get("scatter")
    if scatter is None or scatter.get("found") is None:
        return None
    how, used = fit_quality(scatter_p_value(p_value, content)), scatter["uncertainties_from"] == "scatter"
    both, ratio = _both(scatter["found"], scatter["declared"]), rounded(scatter["found"] / scatter["declared"])
    if (own := one_direction(content)) is not None:
        key = {"bad": "_bad", "nearly": "_nearly"}.get(how, "")
        both, ratio = _both(own, scatter["declared"]), rounded(own / scatter["declared"])
        agree = say(f"fit.one_direction{key}", both=both, ratio=ratio)
        if not lacks_reversal(content):
            return together((agree,))
        half = np.sqrt(scatter["found"] ** 2 - own**2)
        contained = K * np.nanmedian(np.array(content["position_error_u"], dtype=float)) > half
        return together((agree, say("fit.reversal" if contained else "fit.reversal_beside")))
    # Where it is bad all the same, what differs from run to run takes it up: the scatter beside that is as declared.
    key = {"bad": "runs_differ", "too well": "declared_used"}.get(how, "scatter_as_declared")
    return say(f"fit.{'scatter_used' if used else key}", ratio=ratio, both=both)


def scatter_words(content: Mapping[str, Any], p_value: float) -> Said | None:
    """How the readings scatter, each direction or setup where they differ; None for other methods."""
    whole = _scatter_words(content, p_value)
    return None if whole is None else together((whole, *_each_words(content)))


def _each_words(content: Mapping[str, Any]) -> Iterator[Said]:
    for way, sizes in ((content.get("scatter") or {}).get("each") or {}).items():
        ranked = sorted(sizes.items(), key=lambda one: one[1])
        shown, between = (ranked, ", ") if len(ranked) <= MOST_NAMED else ((ranked[0], ranked[-1]), " … ")
        each = (say(f"fit.each_{way}", size=quantity(size, "m"), name=Verbatim(name)) for name, size in shown)
        yield say("fit.each", each=together(each, between))


def _both(found: float, declared: float) -> Said:
    return say("fit.scatter", found=quantity(found, "m"), declared=quantity(declared, "m"))


def free_words(document: Mapping[str, Any]) -> Iterator[Said]:
    """That the readings speak against rigid axes, where the method has a model that takes none for granted.

    Along a single axis both models are one, unless it was read at more places than its tables have nodes. Of the
    document `method`, `model`, `used`, `p_value` and `error_map` are asked; several sessions have no `model`.
    """
    content = document["error_map"] or {}
    if document.get("model") != "rigid_body" or "free" not in method_spec(document["method"]).models:
        return
    points = np.array(content.get("points", ()), dtype=float).reshape(-1, 3)
    if not len(points) or not only_if_right(document["p_value"], content):
        return
    places = len(np.unique(np.round(points / SAME_POSITION), axis=0))
    tables = list(content.get("tables", {}).values())
    if (np.ptp(points, axis=0) > SAME_POSITION).sum() > 1:
        # With a value for each place, as where each axis moved once, nothing could tell.
        if sum((np.array(table["value_u"], dtype=float) > 0.0).sum() for table in tables) < places:
            yield say("fit.free")
        return
    nodes = min((len(table["nodes"]) for table in tables if "nodes" in table), default=places)
    if nodes < places < document["used"]:
        yield say("fit.free_nodes", nodes=nodes, places=places)


def vague_words(content: Mapping[str, Any], fit: JointFit) -> Iterator[Said]:
    """That a map is hardly determined somewhere: its U is of the size of a machine, and not of one's errors.

    A U of the size of what single readings scatter by is that of a coarse instrument.
    """
    scatter = fit.birge_ratio * max(rms(model.sigma) for model in fit.assembly.models)
    u = np.array(content.get("position_error_u", ()), dtype=float)
    places = np.array(content.get("points", content.get("grid", ())), dtype=float)
    if len(places) and np.isfinite(u).any():
        largest, extent = K * float(np.nanmax(u)), float(np.ptp(places, axis=0).max())
        if largest > max(_VAGUE * extent, _WEAK * K * scatter) and extent > 0.0:
            yield say("fit.vague", U=quantity(largest, "m"), extent=f"{1e3 * extent:.4g} mm")


def scatter_change_words(joint: JointFit, memory: float) -> Iterator[Said]:
    """From where on the readings of each session scatter by another size: nothing of those that scatter alike."""
    for own, label in zip(joint.fits, joint.assembly.labels or ("",), strict=True):
        if found := scatter_change(own, memory):
            key = "scatter_grows" if found.ratio > 1.0 else "scatter_falls"
            words = say(f"fit.{key}", row=found.row, ratio=rounded(max(found.ratio, 1.0 / found.ratio)))
            yield together((label, words), ": ") if len(joint.fits) > 1 else words


def off_the_map_words(content: Mapping[str, Any]) -> Iterator[Said]:
    """Which place has a far larger U than most, because its readings agree with each other and not with the map."""
    off = np.array(content.get("off_the_map", ()), dtype=float)
    u = np.array(content.get("position_error_u", ()), dtype=float)
    if not off.any() or not np.isfinite(u).any():
        return
    far = np.flatnonzero(off > _FAR_OFF * np.nanmedian(u[u > 0.0]))
    if len(far):
        at = content["points"][far[np.argmax(off[far])]]
        place = ", ".join(f"{axis} = {1e3 * value:.4g} mm" for axis, value in zip("xyz", at, strict=True))
        yield say("fit.off_the_map", n=len(far), count=len(off), most=quantity(float(off.max()), "m"), place=place)


def effect_words(fit: JointFit, effects: Collection[str]) -> Iterator[str]:
    """A sentence for what an effect may be instead, what is negative and positive by its nature, and a lead's alias."""
    for name in (*effects, BESIDE):
        if fit.alternatives and (instead := fit.alternatives.of(name)):
            each = [f"{other} ({probability(share)})" for other, share in instead.items()]
            if name == BESIDE:
                yield say("fit.beside", names=enumeration(each))
            else:
                yield say("fit.alternatives", name=name, others=together(each, say("diagnosis.or")))
    unknowns = fit.assembly.unknowns
    for found in effect_estimates(fit, list(effects)):
        unknown = unknowns[found.name]
        reversal = found.owner.startswith(("backlash_", "lost_motion_")) and found.name.endswith((".b", ".b0"))
        # A nonlinear coefficient is positive wherever it is looked for.
        if reversal or (unknown.low == 0.0 and unknown.reference == 0.0):
            value, u, largest = found.value, found.standard_uncertainty, -np.inf
            if reversal:
                value, u, largest = _mean_size(fit, found.owner)
            if value < -_SURE * u and largest <= _SURE:
                key = "fit.negative_backlash" if reversal else "fit.negative"
                yield say(key, name=found.owner if reversal else found.name)
        if found.name.endswith("periodic_" + found.owner[-1] + ".lead"):
            position = [own.model.observations.readings.column(found.owner[-1]) for own in fit.fits]
            others = [f"{1e3 * other:.3g} mm" for other in aliases(np.concatenate(position), found.value)]
            if others:
                yield say("fit.alias", name=found.name, others=together(others, say("text.and")))


def _mean_size(fit: JointFit, effect: str) -> tuple[float, float, float]:
    """Mean over the readings of what an effect's first coefficient would be at each, and its standard uncertainty.

    And the largest of them, over its own: beside such a one it has either sign, and none is wrong.
    """
    for own in fit.fits:
        first = len(own.model.own)
        for term in own.model.terms:
            place = slice(first, first + len(term.parameters))
            if term.name == effect:
                known, theta, seen = own.covariance[place, place], own.theta[place], term.columns[0] != 0.0
                weights = term.columns @ term.columns[0] / (term.columns[0] @ term.columns[0])
                each = term.columns[:, seen] / term.columns[0, seen]
                over = (theta @ each) / np.sqrt(np.einsum("kn,kj,jn->n", each, known, each))
                return float(weights @ theta), float(np.sqrt(weights @ known @ weights)), float(over.max())
            first = place.stop
    raise KeyError(effect)
