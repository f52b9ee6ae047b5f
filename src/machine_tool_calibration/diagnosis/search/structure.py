# SPDX-License-Identifier: Apache-2.0
"""Structure in the residuals, whether or not an effect explains it: functions of every covariate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.diagnosis.search.candidates import Candidate, Shaped
from machine_tool_calibration.model.observations import Observations
from machine_tool_calibration.residuals.pool import Pool

__all__ = ["structure_candidates"]

_DEGREE = 4
_ORDERS = (1, 2, 3, 4, 5)
_SIGNS = ("dir_x", "dir_y", "dir_z", "dir_c")
_ANGLES = ("c", "azimuth", "elevation")
# Fewer readings than this show neither a step nor a wave.
_ENOUGH = 40
# Moments at which a step is tried.
_MOMENTS = 24
# Frequencies of the periodogram for each independent one, its largest peaks that are looked at, and the fewest periods
# over the whole session: slower waves are smooth functions.
_OVERSAMPLED, _PEAKS, _FEWEST = 4, 8, 2.5
_MOST_FREQUENCIES = 20000
# Numbers that are worked on at once; sum of squares of a wave below which it is zero at all readings.
_AT_ONCE, _NOTHING = 4e5, 1e-12


def structure_candidates(pool: Pool) -> list[Candidate]:
    """Functions of every covariate that varies, of each session for itself; see `_of_session`."""
    out = []
    for k, (observations, piece) in enumerate(zip(pool.observations, pool.pieces, strict=True)):
        for candidate in _of_session(observations, pool.residuals[piece] / pool.sigma[piece]):
            shapes = tuple(Shaped(s.shape, pool.only(s.columns, piece)) for s in candidate.shapes)
            out.append(replace(candidate, name=pool.label(k) + candidate.name, shapes=shapes))
    return out


def _of_session(observations: Observations, residual: Array) -> list[Candidate]:
    """Smooth functions of every covariate that varies, periodic ones of angles, steps and waves in time.

    A function of time, temperature or direction of approach is also tried as a displacement along each machine axis;
    products of two axis positions show where the machine does not move as rigid bodies, those of a direction of
    approach and a position where lost motion is not the same everywhere.
    """
    out = []
    for name, values in _covariates(observations).items():
        scaled = _scaled(values)
        if scaled is None:
            continue
        if name in _SIGNS:
            functions = {"its sign": np.sign(values)[None]}
        else:
            functions = {"smooth": _smooth(scaled)}
            if name in _ANGLES or name == "normal":
                functions["periodic"] = np.array([w(k * values) for k in _ORDERS for w in (np.sin, np.cos)])
        for shape, columns in functions.items():
            out.append(Candidate(f"{name}: {shape}", (Shaped((), columns),)))
            if name in _SIGNS or name == "time" or name.startswith("temperature"):
                for j, axis in enumerate("xyz"):
                    along = observations.direction[:, j]
                    if np.ptp(along) > 1e-6:
                        label = f"{name}: {shape}, as a displacement along {axis}"
                        out.append(Candidate(label, (Shaped((), columns * along),)))
    out += _products(observations)
    out += _lost_motions(observations)
    out += _events(observations, residual)
    return out


def _smooth(scaled: Array) -> Array:
    """Polynomials of a covariate from -1 to 1, no more than it has values."""
    degree = min(_DEGREE, len(np.unique(np.round(scaled, 9))) - 1)
    return np.asarray(np.polynomial.legendre.legvander(scaled, degree)[:, 1:].T)


def _products(observations: Observations) -> list[Candidate]:
    out = []
    for a, b in ((0, 1), (0, 2), (1, 2)):
        u, v = _scaled(observations.position[:, a]), _scaled(observations.position[:, b])
        if u is None or v is None:
            continue
        columns = np.concatenate([w * observations.direction.T for w in (u * v, u**2 * v, u * v**2)])
        columns = columns[np.abs(columns).max(axis=1) > 1e-9]
        name = f"{'xyz'[a]} and {'xyz'[b]}: product, as a displacement"
        out.append(Candidate(name, (Shaped((), columns),)))
    return out


def _lost_motions(observations: Observations) -> list[Candidate]:
    out = []
    for j, axis in enumerate("xyz"):
        sign = np.sign(observations.readings.columns.get(f"dir_{axis}", np.zeros(len(observations))))
        along = sign * observations.direction[:, j]
        # Where the direction of approach is unknown for some readings, the last is not a number.
        if len(np.unique(sign[sign != 0])) < 2 or not np.ptp(along) >= 1e-6:
            continue
        for k, other in enumerate("xyz"):
            scaled = _scaled(observations.position[:, k])
            if scaled is not None:
                name = f"dir_{axis} and {other}: lost motion of {axis.upper()} that varies along {other}"
                out.append(Candidate(name, (Shaped((), _smooth(scaled) * along),)))
    return out


def _events(observations: Observations, residual: Array) -> list[Candidate]:
    """What comes suddenly, and what comes and goes; the nonlinear coefficient is the moment or the period, s.

    Where no time was recorded, the order of the readings serves, and both are counts of readings.
    """
    name, time = "time" if observations.timed else "order", observations.clock
    if len(time) < _ENOUGH:
        return []
    moments = np.quantile(time, (np.arange(_MOMENTS) + 1.0) / (_MOMENTS + 1.0))
    steps = tuple(Shaped((float(m),), (time > m).astype(float)[None]) for m in np.unique(moments))
    found = [Candidate(f"{name}: a step at", steps)]
    periods = _periods(time, residual)
    if periods:
        phases = [2.0 * np.pi * (time - time[0]) / period for period in periods]
        waves = tuple(
            Shaped((period,), np.array([np.sin(w), np.cos(w)])) for period, w in zip(periods, phases, strict=True)
        )
        found.append(Candidate(f"{name}: a wave with a period of", waves, equally=len(time) // 2))
    return found


def _periods(time: Array, residual: Array) -> list[float]:
    """Periods of the largest peaks of the periodogram (Lomb 1976, Scargle 1982).

    From the session's length down to two readings'. Only these are looked at more closely: at all others less is to
    be explained.
    """
    length = float(np.ptp(time))
    highest = len(time) / (2.0 * length)
    lowest = _FEWEST / length
    count = int(min(_OVERSAMPLED * (highest - lowest) * length, _MOST_FREQUENCIES))
    if count < 3 or not residual.any():
        return []
    frequency = np.linspace(lowest, highest, count)
    power = _periodogram(time - time[0], residual - residual.mean(), frequency)
    # The ends may be peaks as well.
    padded = np.pad(power, 1)
    peaks = np.flatnonzero((power > padded[:-2]) & (power >= padded[2:]))
    best = peaks[np.argsort(-power[peaks])][:_PEAKS]
    step = float(frequency[1] - frequency[0])
    return [float(1.0 / (frequency[k] + shift)) for k in best for shift in (-0.5 * step, 0.0, 0.5 * step)]


def _periodogram(time: Array, values: Array, frequency: Array) -> Array:
    """(f,) sum of squares that a sine and a cosine of each frequency take up.

    `scipy.signal.lombscargle` gives half of it; to load it takes longer than all else here.
    """
    out = np.empty(len(frequency))
    step = max(int(_AT_ONCE / len(time)), 1)
    for part in (slice(k, k + step) for k in range(0, len(frequency), step)):
        phase = 2.0 * np.pi * frequency[part, None] * time
        sine, cosine = np.sin(phase), np.cos(phase)
        # Turned by the phase at which the two are orthogonal (Lomb 1976).
        turn = 0.5 * np.arctan2(2.0 * np.sum(sine * cosine, axis=1), np.sum(cosine**2 - sine**2, axis=1))[:, None]
        sine, cosine = sine * np.cos(turn) - cosine * np.sin(turn), cosine * np.cos(turn) + sine * np.sin(turn)
        out[part] = sum((wave @ values) ** 2 / np.maximum(np.sum(wave**2, axis=1), _NOTHING) for wave in (sine, cosine))
    return out


def _covariates(observations: Observations) -> dict[str, Array]:
    out = dict(observations.readings.columns)
    if np.ptp(observations.path) > 0:
        out["path"] = observations.path
        if not observations.session.spec.reads_deviations:
            # There the reading is the deviation itself, which explains itself.
            out["displacement"] = observations.readings.displacement
        out["path within the setup"] = _within(observations.path, observations.readings.setup)
    if np.abs(observations.table_direction).max() > 0 and observations.session.spec.probes_surface:
        out["normal"] = np.arctan2(observations.table_direction[:, 1], observations.table_direction[:, 0])
    if observations.session.spec.beam_from_pointer:
        out["azimuth"] = np.arctan2(observations.direction[:, 1], observations.direction[:, 0])
        out["elevation"] = np.arcsin(np.clip(observations.direction[:, 2], -1.0, 1.0))
    return {name: values for name, values in out.items() if name not in ("gx", "gy", "gz")}


def _within(values: Array, group: IntArray) -> Array:
    """Values from -1 to 1 over the range of their group."""
    out = np.zeros(len(values))
    for g in np.unique(group):
        scaled = _scaled(values[group == g])
        if scaled is not None:
            out[group == g] = scaled
    return out


def _scaled(values: Array) -> Array | None:
    """The covariate from -1 to 1; None where it does not vary or has gaps."""
    if not np.isfinite(values).all():
        return None
    middle, half = (values.max() + values.min()) / 2, np.ptp(values) / 2
    if half <= 1e-9 * max(abs(middle), 1e-9):
        return None
    return np.asarray((values - middle) / half)
