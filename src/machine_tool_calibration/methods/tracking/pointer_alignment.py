# SPDX-License-Identifier: Apache-2.0
"""Where the rotation centre of an open-loop pointer is, and where its zero angle (Ibaraki et al. 2014, Section 2.2).

Centre (Fig. 6): the retroreflector stands near the rotary axis while the beam turns. An eccentricity (a, b) of it from
the axis average line changes the path by a cos(azimuth) + b sin(azimuth). The paper moves the retroreflector until that
vanishes; here it is calculated. What the path changes by more than once a turn is the radial error motion of the axis;
over less than a turn it is taken for eccentricity in part, as the uncertainty says.

Zero angle (Fig. 7): the beam is held, and the retroreflector moved along Y, within the beam's width. The slope of the
path over y is the sine of the angle from the normal of Y to the beam.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray, gaps_around, groups
from machine_tool_calibration.errors import ModelError

HIGHEST_ORDER = 6
"""Waves a turn up to which the radial error motion is looked at."""
_ROUNDING = 1e-9  # rad, and of singular values as a share
# Least angle by which the beam must turn, rad.
_LEAST_TURN = 0.99 * np.pi
# Decades and number of ratios of the variances of radial error motion and scatter that are looked at; least variance of
# a reading, m^2.
_DECADES, _RATIOS, _LEAST_VARIANCE = 8.0, 81, 1e-30
# Cosine of the beam's angle to the normal of Y below which the slope hardly depends on it.
_ALONG = 0.2
_MOST_ITERATIONS = 20
# Change of an angle that is none, rad.
_DONE = 1e-13


@dataclass(frozen=True)
class Centre:
    """The rotation centre of a pointer."""

    centre: Array  # (2,) x and y of the axis average line, machine frame, m
    offset: Array  # (2,) of the retroreflector from it, m: where the axes say that it stands, less the centre
    covariance: Array  # (2, 2) of the centre, m^2
    contributions: Mapping[str, Array]  # by name, (2,) standard uncertainties of x and y, m; they add in squares
    radial: float  # RMS of the radial error motion of two waves a turn and more, m
    scatter: float  # standard deviation of a reading, m
    residuals: Array  # (n,) what eccentricity leaves of the readings, m: radial error motion and scatter

    @property
    def u(self) -> Array:
        """(2,) standard uncertainty of x and y, m."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


@dataclass(frozen=True)
class ZeroAngle:
    """The zero angle of a pointer."""

    offset: float  # azimuth of the beam less the commanded one, rad; from the normal of Y, positive from +X towards +Y
    u: float  # its standard uncertainty, rad
    scatter: float  # standard deviation of a reading, m: straightness of Y across it included
    residuals: Array  # (n,) what straight lines leave of the readings, m


def rotation_centre(
    azimuth: Array,
    displacement: Array,
    place: Array,
    run: IntArray | None = None,
    *,
    machine: float = 0.0,
    zero: ZeroAngle | None = None,
) -> Centre:
    """The rotation centre from the path (n,) over the azimuth (n,), the retroreflector standing still near the axis.

    The radial error motion is a sum of waves of random size, all orders alike; how large it is, and how much the
    readings scatter, follow from the readings (restricted likelihood), and that it is not known well is in the
    uncertainty. Metres and radians, the path growing with its length; `place` (2,) is the commanded one of the
    retroreflector; readings of one run (n,) count from a common zero; `machine` is the standard uncertainty of the
    machine's position along x and along y; the eccentricity is turned by the pointer's zero, if it is known. A
    ModelError says that the beam turns by less than half a turn, or that there are too few azimuths or readings.
    """
    angle = azimuth if zero is None else azimuth + zero.offset
    own = _constants(np.zeros(len(angle), dtype=np.int64) if run is None else run)
    fixed = np.column_stack([np.cos(angle), np.sin(angle), own])
    waves = [wave(order * angle) for order in range(2, HIGHEST_ORDER + 1) for wave in (np.cos, np.sin)]
    random = np.column_stack(waves)
    fit = _mixed(angle, fixed, random, displacement)
    found, noise, radial, (variance, size) = fit.averaged()
    parts = {"scatter of the readings": noise[:2, :2], "radial error motion of the axis": radial[:2, :2]}
    if machine > 0:
        parts["positioning error of the machine"] = machine**2 * np.eye(2)
    if zero is not None:
        across = np.array([-found[1], found[0]])
        parts["zero angle of the pointer"] = zero.u**2 * np.outer(across, across)
    return Centre(
        centre=np.asarray(place, dtype=float)[:2] - found[:2],
        offset=found[:2],
        covariance=np.sum(list(parts.values()), axis=0),
        contributions={name: np.sqrt(np.diag(part)) for name, part in parts.items()},
        radial=float(np.sqrt(size * random.shape[1] / 2)),
        scatter=float(np.sqrt(variance)),
        residuals=displacement - fixed @ found,
    )


def _mixed(angle: Array, fixed: Array, random: Array, displacement: Array) -> _Mixed:
    """The readings as eccentricity, waves of random size and scatter; a ModelError if they do not tell these apart."""
    turned = 2 * np.pi - float(gaps_around(angle)[1].max())
    if turned < _LEAST_TURN:
        raise ModelError(
            f"the beam turns by {np.degrees(turned):.0f}° only: over less than half a turn the radial error motion of "
            "the axis cannot be told from eccentricity"
        )
    if np.linalg.svd(fixed, compute_uv=False)[-1] < _ROUNDING * len(angle):
        raise ModelError("two opposite azimuths do not tell where the axis is: three or more different ones are needed")
    span, sizes, _ = np.linalg.svd(np.column_stack([fixed, random]), full_matrices=False)
    span = span[:, sizes > _ROUNDING * sizes[0]]
    inner = span.T @ displacement
    outside = displacement - span @ inner
    if len(displacement) <= span.shape[1]:
        raise ModelError(
            f"too few readings: {len(displacement)} at {len(np.unique(angle))} azimuths do not tell the scatter from "
            f"the radial error motion; more than {span.shape[1]} are needed"
        )
    return _Mixed(span.T @ fixed, span.T @ random, inner, float(outside @ outside), len(displacement))


@dataclass(frozen=True)
class _Mixed:
    """Fixed unknowns, random ones of a common variance, and scatter, in the space that both span."""

    fixed: Array  # (m, p)
    random: Array  # (m, q)
    inner: Array  # (m,) the readings there
    outside: float  # sum of squares of what is beside it
    count: int  # number of readings

    def at(self, ratio: float) -> tuple[Array, float, float]:
        """(p, m) best linear unbiased estimator, variance of a reading, logarithm of the restricted likelihood."""
        weight = np.asarray(np.linalg.inv(np.eye(len(self.inner)) + ratio * self.random @ self.random.T))
        information = self.fixed.T @ weight @ self.fixed
        solve = np.linalg.solve(information, self.fixed.T @ weight)
        left = self.inner - self.fixed @ (solve @ self.inner)
        dof = self.count - self.fixed.shape[1]
        variance = (float(left @ weight @ left) + self.outside) / dof
        logs = np.linalg.slogdet(weight)[1] - np.linalg.slogdet(information)[1]
        return np.asarray(solve), variance, float(logs - dof * np.log(max(variance, _LEAST_VARIANCE))) / 2

    def averaged(self) -> tuple[Array, Array, Array, tuple[float, float]]:
        """The fixed unknowns (p,), averaged over the ratio by its probability (flat in the random ones' size).

        Also (p, p) covariances from scatter and from the random unknowns, and variances of a reading and a
        random unknown.
        """
        ratios = 10.0 ** np.linspace(-_DECADES, _DECADES, _RATIOS)
        fits = [self.at(ratio) for ratio in ratios]
        logs = np.array([fit[2] for fit in fits]) + np.log(ratios) / 2
        share = np.exp(logs - logs.max())
        share /= share.sum()
        values = np.array([solve @ self.inner for solve, _, _ in fits])
        mean = share @ values
        variances = np.array([variance for _, variance, _ in fits])
        weights = share * variances
        noise = np.sum([w * solve @ solve.T for w, (solve, _, _) in zip(weights, fits, strict=True)], axis=0)
        leaked = [solve @ self.random for solve, _, _ in fits]
        radial = np.sum([w * r * part @ part.T for w, r, part in zip(weights, ratios, leaked, strict=True)], axis=0)
        radial += (values - mean).T @ ((values - mean) * share[:, None])
        return mean, noise, radial, (float(weights.sum()), float(weights @ ratios))


def zero_angle(y: Array, displacement: Array, azimuth: Array, run: IntArray | None = None) -> ZeroAngle:
    """The zero angle from the path (n,) over commanded y (n,), m, the beam being held at azimuths (n,), rad.

    Readings of one run count from a common zero; those of one azimuth if no run is given. A ModelError says that Y
    does not move in a run, the beam runs along Y, or there are too few readings.
    """
    same = groups(np.round(azimuth / _ROUNDING).astype(np.int64))
    run = same if run is None else groups(same, run)
    own = _constants(run)
    if np.abs(np.cos(azimuth)).min() < _ALONG:
        raise ModelError("the beam runs nearly along Y: the path hardly changes with its angle; hold it across Y")
    free = y - own @ np.linalg.lstsq(own, y, rcond=None)[0]
    dof = len(y) - own.shape[1] - 1
    if np.abs(free).max(initial=0.0) < _ROUNDING or dof < 1:
        raise ModelError(
            "Y does not move, or there are too few readings: three or more places of it are needed in a run"
        )
    offset = 0.0
    for _ in range(_MOST_ITERATIONS):
        left = displacement - y * np.sin(azimuth + offset)
        left = left - own @ np.linalg.lstsq(own, left, rcond=None)[0]
        column = free * np.cos(azimuth + offset)
        step = float(column @ left / (column @ column))
        offset += step
        if abs(step) < _DONE:
            break
    scatter = float(np.sqrt(left @ left / dof))
    return ZeroAngle(offset, scatter / float(np.linalg.norm(column)), scatter, left)


def _constants(run: IntArray) -> Array:
    """(n, runs) one column for each run."""
    return np.asarray(run[:, None] == np.unique(run), dtype=float)
