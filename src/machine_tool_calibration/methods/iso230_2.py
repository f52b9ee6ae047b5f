# SPDX-License-Identifier: Apache-2.0
"""Positioning along a line: of one axis by ISO 230-2:2014, along diagonals by ISO 230-6:2002.

Clause 3 of ISO 230-2: at m positions P_i, each approached n times in the positive direction (up) and n times in the
negative one (down), the deviations x_ij are actual minus target position. ISO 230-6 has the same of body and face
diagonals, and of all diagonals the largest systematic deviation E_D and the largest reversal B_D.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import Array, BoolArray, IntArray, groups, means_of, occurrence, rms
from machine_tool_calibration.coverage import K
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.approach import begins_run, in_steps, senses
from machine_tool_calibration.session.catalogue import spec_of

_DRAWS = 200
# Square of a deviation that is nothing, m^2.
_NOTHING = 1e-24
# Cosine between the direction that is read and the line from which it is read along it.
_ALONG = 0.9999
# Extent of a place, m; how far off the line a reading may be, m.
_PLACE_EXTENT, _OFF_LINE = 1e-6, 1e-5


@dataclass(frozen=True)
class Positioning:
    """Figures of one axis; NaN where the readings do not give them (a direction or repeats missing)."""

    position: Array  # (m,) target positions, m
    mean_up: Array  # (m,) mean unidirectional deviations, 3.10
    mean_down: Array
    s_up: Array  # (m,) estimators of the unidirectional repeatability (standard deviation with n - 1), 3.13
    s_down: Array
    count_up: IntArray  # (m,) readings in each direction
    count_down: IntArray
    reversal: Array  # (m,) mean_up - mean_down, 3.11
    repeatability: Array  # (m,) R_i = max(2 s_up + 2 s_down + |B_i|, 4 s_up, 4 s_down), 3.15
    B: float  # largest absolute, and mean reversal of the axis, 3.11, 3.12
    B_mean: float
    R_up: float  # uni- and bidirectional repeatability of the axis, 3.14, 3.15
    R_down: float
    R: float
    E_up: float  # uni- and bidirectional systematic positioning deviation, 3.16, 3.17
    E_down: float
    E: float
    M: float  # range of the mean bidirectional positioning deviation, 3.18
    A_up: float  # uni- and bidirectional positioning accuracy (two standard deviations), 3.19, 3.20
    A_down: float
    A: float


FIGURES = tuple(field.name for field in fields(Positioning) if field.type == "float")
"""Names of the figures of an axis."""


def positioning(position: Array, direction: Array, deviation: Array) -> Positioning:
    """The figures of ISO 230-2:2014 from target positions, senses of approach (+1, -1) and deviations (n,), m.

    A figure that takes the worst of all positions is given only where every position has what it needs, but for the
    ends at which runs turned that did not go beyond.
    """
    target = np.unique(position)
    up, down = (_runs(target, position, deviation, direction * sign > 0) for sign in (1, -1))
    (up_mean, up_s), (down_mean, down_s) = _mean_and_s(up), _mean_and_s(down)
    up_n, down_n = (np.isfinite(runs).sum(axis=0) for runs in (up, down))
    repeatability = _repeatability(up_mean, up_s, down_mean, down_s)
    counted = counted_positions(up_n, down_n)
    of_axis = _of_axis(*(values[counted] for values in (up_mean, up_s, down_mean, down_s)))
    figures: dict[str, Any] = {name: float(value) for name, value in of_axis.items()}
    found = (up_mean, down_mean, up_s, down_s, up_n, down_n, up_mean - down_mean, repeatability)
    return Positioning(target, *found, **figures)


def counted_positions(count_up: IntArray, count_down: IntArray) -> BoolArray:
    """(m,) positions of which the figures are: all but an end that was approached from one side, where runs turned."""
    both = (np.asarray(count_up) > 0) & (np.asarray(count_down) > 0)
    counted = np.ones(len(both), dtype=bool)
    if both[1:-1].any() and both[1:-1].all():
        counted[[0, -1]] = both[[0, -1]]
    return counted


def _repeatability(up_mean: Array, up_s: Array, down_mean: Array, down_s: Array) -> Array:
    both = 2 * up_s + 2 * down_s + np.abs(up_mean - down_mean)
    return np.asarray(np.max(np.stack([both, 4 * up_s, 4 * down_s]), axis=0))


def _of_axis(up_mean: Array, up_s: Array, down_mean: Array, down_s: Array) -> dict[str, Array]:
    """The axis's figures by name, each (…), from means and standard deviations (…, m) at its positions."""
    reversal = up_mean - down_mean
    means, s = np.concatenate([up_mean, down_mean], axis=-1), np.concatenate([up_s, down_s], axis=-1)
    return {
        "B": np.max(np.abs(reversal), axis=-1),
        "B_mean": np.mean(reversal, axis=-1),
        "R_up": np.max(4 * up_s, axis=-1),
        "R_down": np.max(4 * down_s, axis=-1),
        "R": np.max(_repeatability(up_mean, up_s, down_mean, down_s), axis=-1),
        "E_up": np.ptp(up_mean, axis=-1),
        "E_down": np.ptp(down_mean, axis=-1),
        "E": np.ptp(means, axis=-1),
        "M": np.ptp((up_mean + down_mean) / 2, axis=-1),
        "A_up": _accuracy(up_mean, up_s),
        "A_down": _accuracy(down_mean, down_s),
        "A": _accuracy(means, s),
    }


def _accuracy(mean: Array, s: Array) -> Array:
    return np.asarray(np.max(mean + 2 * s, axis=-1) - np.min(mean - 2 * s, axis=-1))


def positioning_uncertainty(figures: Positioning, runs_up: Array, runs_down: Array) -> dict[str, float]:
    """Expanded uncertainty (k = 2) by figure, from the repeatability that the figures were found with.

    As of repeated tests: every figure is worked out again for runs that are drawn, with the standard deviation found of
    each direction over all positions, of which the runs as a whole have their share; about the means found, whose
    reversals differ by no more than noise does not explain. U is twice the root mean square of what comes out about the
    figure of those means, as the largest of many is too large by chance. The uncertainty of the instrument and of its
    alignment and temperature (the standard's Annex A, from certificates that a session does not hold) is not in it;
    figures that the readings do not give are left out.

    Args:
        figures: as found.
        runs_up: (k, m) deviations of the runs upwards, m; NaN where a position was not read.
        runs_down: (l, m) of those downwards.
    """
    rng = np.random.default_rng(1)
    told = [np.isfinite(s) for s in (figures.s_up, figures.s_down)]
    seen = counted_positions(figures.count_up, figures.count_down) & (told[0] | told[1])
    if not seen.any():
        return {}
    # One scatter for all positions: that of a single one, from a few runs, is itself uncertain.
    pooled = [rms(s[t & seen]) for s, t in zip((figures.s_up, figures.s_down), told, strict=True)]
    counts = [np.maximum(count, 1) for count in (figures.count_up, figures.count_down)]
    reversal = figures.reversal[np.isfinite(figures.reversal) & seen]
    off = np.nan_to_num(figures.reversal - np.mean(reversal)) if len(reversal) else np.zeros(len(seen))
    noise = float(np.mean(sum(s**2 / n[seen] for s, n in zip(pooled, counts, strict=True))))
    explained = 1.0 - np.sqrt(1.0 - noise / max(rms(off[seen]) ** 2, noise, _NOTHING))
    drawn, true = list[Array](), list[Array]()
    for sign, mean, runs, t, s in (
        (-0.5, figures.mean_up, runs_up, told[0], pooled[0]),
        (0.5, figures.mean_down, runs_down, told[1], pooled[1]),
    ):
        centre = (mean + sign * explained * off)[seen]
        read = np.where(np.isfinite(runs) & t, 0.0, np.nan)[:, seen]
        shared = _shared_by_runs((runs - mean)[:, seen] + read, s)
        own = np.sqrt(max(s**2 - shared**2, 0.0)) * rng.standard_normal((_DRAWS, *read.shape))
        all_of_run = shared * rng.standard_normal((_DRAWS, len(read), 1))
        drawn += _mean_and_s(centre + read + own + all_of_run)
        nothing, no_scatter = _mean_and_s(read)
        true += [centre + nothing, s + no_scatter]
    found, expected = _of_axis(*drawn), _of_axis(*true)
    out = {name: K * rms(found[name] - expected[name]) for name in FIGURES}
    return {name: value for name, value in out.items() if np.isfinite(value) and np.isfinite(getattr(figures, name))}


def _shared_by_runs(residuals: Array, s: float) -> float:
    """Standard deviation that all readings of a run have in common, m, from (k, m) deviations from the means."""
    mean, count = _mean_and_s(residuals.T)[0], np.isfinite(residuals).sum(axis=1)
    known = mean[count > 0]
    if len(known) < 2:
        return 0.0
    between = float(np.sum(known**2)) / (len(known) - 1)
    return float(np.sqrt(np.clip(between - s**2 * np.mean(1.0 / count[count > 0]), 0.0, s**2)))


def _mean_and_s(runs: Array) -> list[Array]:
    """Mean and standard deviation (…, m) of runs (…, k, m), of those that read a position; NaN where too few did."""
    count = np.isfinite(runs).sum(axis=-2)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.nansum(runs, axis=-2) / np.where(count > 0, count, np.nan)
        squares = np.nansum((runs - mean[..., None, :]) ** 2, axis=-2)
        return [mean, np.sqrt(squares / np.where(count > 1, count - 1, np.nan))]


def positioning_runs(
    observations: Observations, *, diagonals: bool = False, uncertain: bool = True
) -> list[dict[str, Any]]:
    """Figures of every setup in which a line was read along itself, in both directions or repeatedly.

    For each its id, the `axis` (X; of a diagonal, if `diagonals` are wanted, the signs of its motion along X, Y, Z:
    `NPP`, `NP0`), the fields of `Positioning`, the single runs `runs_up` and `runs_down` (runs, m), m, and, if
    wanted (they take most of the time), the expanded uncertainties (k = 2) of the figures, `B_U` and so on, as far
    as the runs determine them. The positions of a diagonal count from its end.
    """
    out = []
    for index, name in enumerate(observations.session.setup_ids):
        mine = np.flatnonzero(observations.readings.setup == index)
        line = _line(observations, mine)
        if line is None or diagonals != (np.count_nonzero(line) > 1):
            continue
        mine = mine[_on(observations.position[mine], line)]
        position, direction, deviation = _approach(observations, mine, line)
        places, times = np.unique(position, return_counts=True)
        # In one direction once, or there and back at other places.
        alone = not diagonals and 2 * np.count_nonzero(times > 1) < len(places)
        if len(places) < 2 or alone:
            continue
        figures = positioning(position, direction, deviation)
        runs = {way: _runs(figures.position, position, deviation, direction * sign > 0)
                for way, sign in (("up", 1.0), ("down", -1.0))}  # fmt: skip
        if not any(map(len, runs.values())):
            continue  # read at random, in no runs
        uncertainties = positioning_uncertainty(figures, runs["up"], runs["down"]) if uncertain else {}
        expanded = {f"{key}_U": value for key, value in uncertainties.items()}
        signs = "".join("N0P"[int(np.sign(part)) + 1] for part in line)
        axis = signs if diagonals else "XYZ"[int(np.argmax(line))]
        told = {"setup": name, "axis": axis, **asdict(figures), **expanded}
        told |= {f"runs_{way}": own for way, own in runs.items()}
        if expanded:
            told["note"] = "U is from the repeatability of the runs alone; that of the instrument comes on top."
        out.append(told)
    return out


def diagonal_tests(observations: Observations) -> dict[str, Any]:
    """Diagonal displacement tests by ISO 230-6:2002, as an entry `iso230_6` of a map; empty where there are none.

    Of the body diagonals and of the face diagonals of each plane together: E_D (and of each direction of approach) is
    the largest bidirectional systematic deviation E of a diagonal, B_D the largest reversal B; each with the expanded
    uncertainty of the diagonal that it is of. NaN where the runs went one way only.
    """
    runs = positioning_runs(observations, diagonals=True)
    return {"iso230_6": of_diagonals(runs)} if runs else {}


def of_diagonals(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """An entry `iso230_6` of a map: the runs along diagonals, and the figures of all of a kind together."""
    kinds: dict[str, list[dict[str, Any]]] = {}
    for run in runs:
        plane = "".join(axis for axis, sign in zip("XYZ", run["axis"], strict=True) if sign != "0")
        kinds.setdefault("body" if len(plane) == 3 else plane, []).append(run)
    tests = []
    for kind, own in kinds.items():
        # one diagonal, whichever way it was moved
        measured = {frozenset((run["axis"], run["axis"].translate(str.maketrans("PN", "NP")))) for run in own}
        told = {"diagonals": kind, "measured": len(measured), "of": 4 if kind == "body" else 2}
        tests.append(told | _largest(own, "E") | _largest(own, "E_up") | _largest(own, "E_down") | _largest(own, "B"))
    return {"runs": list(runs), "tests": tests}


def _largest(runs: Sequence[dict[str, Any]], figure: str) -> dict[str, float]:
    """The largest of a figure with its expanded uncertainty, under its name of ISO 230-6; NaN where one lacks it."""
    worst = runs[int(np.argmax([run[figure] for run in runs]))]  # the first NaN, where there is one
    name = figure.replace("E", "E_D").replace("B", "B_D")
    return {name: float(worst[figure]), f"{name}_U": float(worst.get(f"{figure}_U", np.nan))}


def _line(observations: Observations, mine: IntArray) -> Array | None:
    """(3,) line along which all readings sense and on which they begin and end, an axis's upwards; None if none."""
    if len(mine) < 4:
        return None
    position, direction = observations.position[mine], observations.direction[mine]
    far = position[np.argmax(np.linalg.norm(position - position[0], axis=1))] - position[0]
    length = float(np.linalg.norm(far))
    if length < _PLACE_EXTENT or np.abs(direction @ far).min() < _ALONG * length:
        return None
    line = np.where(np.abs(far) > _PLACE_EXTENT, far, 0.0) / length
    line = np.abs(line) if np.count_nonzero(line) == 1 else line
    # Only what moves in steps is read off its line between two places on it.
    return line if spec_of(observations.session).states_runs or _on(position, line).all() else None


def _on(position: Array, line: Array) -> BoolArray:
    """(n,) which positions lie on the line through the first one."""
    arm = position - position[0]
    return np.asarray(np.linalg.norm(arm - np.outer(arm @ line, line), axis=1) < _OFF_LINE)


def _approach(observations: Observations, mine: IntArray, line: Array) -> tuple[Array, Array, Array]:
    """Target positions, those within a hair made equal, signs of approach, and deviations, m."""
    place = observations.position[mine] @ line
    readings, spec = observations.readings, spec_of(observations.session)
    deviation = readings.displacement[mine] * np.sign(observations.direction[mine] @ line)
    if np.count_nonzero(line) > 1:
        place = place - place.min()
    group = in_steps(place)
    target = means_of(group, place)
    leading = int(np.argmax(np.abs(line)))
    recorded = readings.columns.get(f"dir_{'xyz'[leading]}")
    again = np.zeros(len(mine), dtype=bool)
    if not spec.reads_deviations:
        # A length counts from the first reading of its run, which has no move before it.
        first = np.array([np.flatnonzero(readings.repeat[mine] == k)[0] for k in readings.repeat[mine]])
        deviation = deviation - deviation[first] - (target - target[first])
        again[first] = True
    elif recorded is not None and np.isin(recorded[mine], (-1.0, 1.0)).all():
        return target, recorded[mine] * np.sign(line[leading]), deviation
    elsewhere = np.diff(group, prepend=-1) != 0
    return target, senses(group, elsewhere, again | begins_run(group, readings.repeat[mine], elsewhere)), deviation


def _runs(targets: Array, position: Array, deviation: Array, mine: BoolArray) -> Array:
    """(runs, m) deviations of the readings of one direction, the k-th at each target in the k-th run; NaN: none."""
    at = np.searchsorted(targets, position[mine])
    run = occurrence(groups(at)) if len(at) else at
    out = np.full((int(run.max(initial=-1)) + 1, len(targets)), np.nan)
    out[run, at] = deviation[mine]
    return out
