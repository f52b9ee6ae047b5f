# SPDX-License-Identifier: Apache-2.0
"""Circular tests by ISO 230-4:2005: circular deviations G and G(b), hysteresis H, radial deviations F and mean D.

All are of radial deviations about the least-squares circle: of one way round for G, of both for the others. Readings of
one place and one way round are averaged over the runs before a range is taken, so that it does not grow with them.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from machine_tool_calibration.arrays import NORMAL_MEDIAN, Array, groups
from machine_tool_calibration.coverage import K
from machine_tool_calibration.methods.ball_bar.circle import angles, arms, travel_sense
from machine_tool_calibration.model.fit import Fit
from machine_tool_calibration.model.model import Term
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.session.description import BallBar

# Draws of a range or a largest value.
_DRAWS = 300
# Change of the radius that is rounding, m: of a cause that does not act in a plane.
_NOTHING = 1e-12

WAYS: Mapping[str, float] = {"ccw": 1.0, "cw": -1.0}
"""Ways round, and their sense."""

# Readings of a run of which second differences tell the noise.
_TELLING = 12


@dataclass(frozen=True)
class _Path:
    """The mean of all runs of one way round, place by place in the order of the angle."""

    angle: Array  # (k,) rad
    radial: Array  # (k,) radial deviation as it was read, m
    u: Array  # (k,) its standard uncertainty, m

    def about(self, circle: Array) -> Array:
        """(k,) radial deviations about a circle: offsets of its centre along both axes and of its radius, m."""
        return np.asarray(self.radial - _columns(self.angle) @ circle)


def circular_tests(
    seen: Observations, second_order: Array, u: Array
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Figures of every setup, and the paths that they are of.

    Args:
        seen: the readings.
        second_order: (n,) what the offset of the centre adds to its first order, m.
        u: (n,) standard uncertainty of a reading, m, by how all scatter about the model.

    Returns:
        Entries with `standard`, `setup`, `name`, `value`, expanded uncertainty `U` (k = 2) and `unit`; and of each
        setup and way round `angle`, rad, and `deviation` about the least-squares circle of both, m. Nothing where the
        way round was not recorded.
    """
    description = seen.session.description.as_a(BallBar)
    arm, plane = arms(description, seen.readings)
    sense = travel_sense(arm, plane, seen.readings)
    figures: list[dict[str, Any]] = []
    circles: list[dict[str, Any]] = []
    if sense is None:
        return figures, circles
    angle, radial = angles(arm, plane), seen.readings.displacement - second_order
    # What the model lacks is the machine's, and in the figures: it is no noise of theirs.
    u = np.minimum(u, _noise(seen, sense, radial))
    for index, setup in enumerate(description.setups):
        paths = {}
        for way, sign in WAYS.items():
            mine = (seen.readings.setup == index) & (sense == sign)
            if mine.sum() > len(_columns(angle[:1])[0]):
                paths[way] = _mean_path(angle[mine], radial[mine], u[mine])
        if not paths:
            continue
        both = _fitted(*paths.values())
        for name, value, expanded in _figures(paths, both, description.length_uncertainty):
            figures.append(_figure(setup.id, name, value, expanded))
        for way, path in paths.items():
            entry = {"setup": setup.id, "plane": setup.plane, "way": way, "angle": path.angle}
            circles.append({**entry, "deviation": path.about(both)})
    return figures, circles


def _noise(seen: Observations, sense: Array, radial: Array) -> Array:
    """(n,) standard uncertainty of a reading, m, by second differences along its run; no smaller than declared.

    Of independent readings these have a variance of six. Infinite where a run is too short to tell.
    """
    run = groups(seen.readings.setup, seen.readings.repeat, np.nan_to_num(sense))
    out = np.full(len(radial), np.inf)
    for mine in (np.flatnonzero(run == one) for one in np.unique(run)):
        if len(mine) >= _TELLING:
            bent = np.median(np.abs(np.diff(radial[mine], 2))) / (NORMAL_MEDIAN * np.sqrt(6.0))
            out[mine] = np.maximum(bent, seen.session.sigma)
    return out


def _figure(setup: str, name: str, value: float, expanded: float) -> dict[str, Any]:
    return {"standard": "ISO 230-4", "setup": setup, "name": name, "value": value, "U": expanded, "unit": "m"}


def _columns(angle: Array) -> Array:
    return np.column_stack([np.cos(angle), np.sin(angle), np.ones(len(angle))])


def _mean_path(angle: Array, radial: Array, u: Array) -> _Path:
    place = groups(np.round(np.mod(angle, 2.0 * np.pi) * 1e7))
    count = np.bincount(place)
    mean, at = np.bincount(place, radial) / count, np.bincount(place, np.mod(angle, 2.0 * np.pi)) / count
    order = np.argsort(at)
    return _Path(at[order], mean[order], np.sqrt(np.bincount(place, u**2))[order] / count[order])


def _fitted(*paths: _Path) -> Array:
    """(3,) the least-squares circle."""
    angle, radial = (np.concatenate([getattr(p, name) for p in paths]) for name in ("angle", "radial"))
    return np.asarray(np.linalg.lstsq(_columns(angle), radial, rcond=1e-6)[0])


def _figures(paths: Mapping[str, _Path], both: Array, length_u: float | None) -> Iterator[tuple[str, float, float]]:
    """Name, value and U of each figure."""
    for way, path in paths.items():
        yield f"G_{way}", *_range(path.about(_fitted(path)), path.u)
    angle, u = (np.concatenate([getattr(path, name) for path in paths.values()]) for name in ("angle", "u"))
    if len(paths) == 2:
        yield "G_b", *_range(np.concatenate([path.about(both) for path in paths.values()]), u)
        if (between := _hysteresis(paths["ccw"], paths["cw"])) is not None:
            yield "H", *between
    if length_u is None:
        return
    centre = np.append(both[:2], 0.0)
    for way, path in paths.items():
        radial = path.about(centre)
        for name, at in (("F_max", int(np.argmax(radial))), ("F_min", int(np.argmin(radial)))):
            yield f"{name}_{way}", float(radial[at]), K * float(np.hypot(path.u[at], length_u))
    if len(paths) == 2:
        noise = float(np.linalg.norm(np.linalg.pinv(_columns(angle))[2] * u))
        yield "D", float(both[2]), K * float(np.hypot(noise, length_u))


def _range(deviation: Array, u: Array) -> tuple[float, float]:
    return float(np.ptp(deviation)), _expanded(deviation, u, np.ptp)


def _expanded(values: Array, u: Array, figure: Callable[[Array], float]) -> float:
    """U (k = 2) of a range or a largest value, which noise makes larger.

    Of values that are drawn about those found, with their standard uncertainties (k,), it is larger still: by what
    noise that is larger by the root of two adds. None of exact ones.
    """
    if not u.any():
        return 0.0
    rng = np.random.default_rng(1)
    drawn = np.array([figure(values + u * rng.standard_normal(len(u))) for _ in range(_DRAWS)])
    too_large = (drawn.mean() - figure(values)) / (np.sqrt(2.0) - 1.0)
    return K * float(np.hypot(drawn.std(), too_large))


def _hysteresis(forth: _Path, back: _Path) -> tuple[float, float] | None:
    """Largest distance between both paths at one angle, and its U; None where they have no angle in common."""
    low, high = max(forth.angle[0], back.angle[0]), min(forth.angle[-1], back.angle[-1])
    at = forth.angle[(forth.angle >= low) & (forth.angle <= high)]
    if not len(at):
        return None
    there = np.isin(forth.angle, at)
    apart = forth.radial[there] - np.interp(at, back.angle, back.radial)
    u = np.hypot(forth.u[there], np.interp(at, back.angle, back.u))
    return float(np.abs(apart).max()), _expanded(apart, u, lambda values: float(np.abs(values).max()))


def contributions(fit: Fit, terms: Sequence[Term], first: int) -> list[dict[str, Any]]:
    """Of every cause in the model what it adds to the radius, as G(b) it would have alone, the largest first.

    The causes are terms, the first of whose unknowns has that place in the fit.
    """
    seen, out = fit.model.observations, []
    arm, plane = arms(seen.session.description.as_a(BallBar), seen.readings)
    angle = angles(arm, plane)
    for term in terms:
        mine = np.arange(first, first + len(term.parameters))
        first += len(mine)
        if not fit.determined[mine].all():
            continue
        for index, setup in enumerate(seen.session.description.as_a(BallBar).setups):
            own = seen.readings.setup == index
            base = _columns(angle[own])
            if own.sum() <= base.shape[1]:
                continue
            left = term.columns[:, own].T
            left = left - base @ np.linalg.lstsq(base, left, rcond=1e-6)[0]
            change = left @ fit.theta[mine]
            if np.ptp(change) < _NOTHING:
                continue
            apart = left[int(np.argmax(change))] - left[int(np.argmin(change))]
            u = float(np.sqrt(max(apart @ fit.covariance[np.ix_(mine, mine)] @ apart, 0.0)))
            out.append(_figure(setup.id, f"G_b of {term.name}", float(np.ptp(change)), K * u))
    return sorted(out, key=lambda one: -one["value"])
