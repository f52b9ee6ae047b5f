"""Structure in the residuals, whether or not an effect explains it: functions of every covariate."""

from __future__ import annotations

import numpy as np

from machine_tool_calibration.arrays import Array, IntArray
from machine_tool_calibration.diagnosis.candidates import Block, Candidate
from machine_tool_calibration.model.observations import Observations

__all__ = ["structure_candidates"]

_DEGREE = 4
_ORDERS = (1, 2, 3, 4, 5)
_SIGNS = ("dir_x", "dir_y", "dir_z", "dir_c")
_ANGLES = ("c", "azimuth", "elevation")
# Fewer readings than this show neither a step nor a wave.
_ENOUGH = 40
# Moments at which a step is tried, and numbers of periods over the whole session.
_MOMENTS = 24
_PERIODS = tuple(range(3, 25))


def structure_candidates(observations: Observations) -> list[Candidate]:
    """Smooth functions of every covariate that varies, periodic ones of angles.

    A function of time, temperature or direction of approach is also tried as a displacement along each machine axis;
    products of two axis positions show where the machine does not move as rigid bodies, those of a direction of
    approach and a position where lost motion is not the same everywhere.
    """
    out = []
    n = len(observations)
    for name, values in _covariates(observations).items():
        scaled = _scaled(values)
        if scaled is None:
            continue
        if name in _SIGNS:
            functions = {"its sign": np.sign(values)[None]}
        else:
            degree = min(_DEGREE, len(np.unique(np.round(scaled, 9))) - 1)
            functions = {"smooth": np.polynomial.legendre.legvander(scaled, degree)[:, 1:].T}
            if name in _ANGLES or name == "normal":
                functions["periodic"] = np.array([w(k * values) for k in _ORDERS for w in (np.sin, np.cos)])
        for shape, columns in functions.items():
            out.append(Candidate(f"{name}: {shape}", (Block((), columns),), 0, n))
            if name in _SIGNS or name == "time" or name.startswith("temperature"):
                for j, axis in enumerate("xyz"):
                    along = observations.direction[:, j]
                    if np.ptp(along) > 1e-6:
                        label = f"{name}: {shape}, as a displacement along {axis}"
                        out.append(Candidate(label, (Block((), columns * along),), 0, n))
    out += _products(observations)
    out += _lost_motions(observations)
    out += _events(observations)
    return out


def _products(observations: Observations) -> list[Candidate]:
    out = []
    for a, b in ((0, 1), (0, 2), (1, 2)):
        u, v = _scaled(observations.position[:, a]), _scaled(observations.position[:, b])
        if u is None or v is None:
            continue
        columns = np.concatenate(
            [
                (u * v * observations.direction.T),
                (u**2 * v * observations.direction.T),
                (u * v**2 * observations.direction.T),
            ]
        )
        columns = columns[np.abs(columns).max(axis=1) > 1e-9]
        name = f"{'xyz'[a]} and {'xyz'[b]}: product, as a displacement"
        out.append(Candidate(name, (Block((), columns),), 0, len(observations)))
    return out


def _lost_motions(observations: Observations) -> list[Candidate]:
    out = []
    for j, axis in enumerate("xyz"):
        sign = np.sign(observations.readings.columns.get(f"dir_{axis}", np.zeros(len(observations))))
        along = sign * observations.direction[:, j]
        if len(np.unique(sign[sign != 0])) < 2 or np.ptp(along) < 1e-6:
            continue
        for k, other in enumerate("xyz"):
            scaled = _scaled(observations.position[:, k])
            if scaled is not None:
                degree = min(_DEGREE, len(np.unique(np.round(scaled, 9))) - 1)
                shapes = np.polynomial.legendre.legvander(scaled, degree)[:, 1:].T
                name = f"dir_{axis} and {other}: lost motion of {axis.upper()} that varies along {other}"
                out.append(Candidate(name, (Block((), shapes * along),), 0, len(observations)))
    return out


def _events(observations: Observations) -> list[Candidate]:
    """What comes suddenly, and what comes and goes; the nonlinear coefficient is the moment or the period, s."""
    time = observations.readings.columns.get("time", np.arange(len(observations), dtype=float))
    scaled = _scaled(time)
    if scaled is None or len(time) < _ENOUGH:
        return []
    moments = np.quantile(time, (np.arange(_MOMENTS) + 1.0) / (_MOMENTS + 1.0))
    steps = tuple(Block((float(m),), (time > m).astype(float)[None]) for m in np.unique(moments))
    turns, duration = np.pi * (scaled + 1.0), float(np.ptp(time))
    waves = tuple(Block((duration / k,), np.array([np.sin(k * turns), np.cos(k * turns)])) for k in _PERIODS)
    n = len(observations)
    return [Candidate("time: a step at", steps, 1, n), Candidate("time: a wave with a period of", waves, 1, n)]


def _covariates(observations: Observations) -> dict[str, Array]:
    out = dict(observations.readings.columns)
    if np.ptp(observations.path) > 0:
        out["path"] = observations.path
        if observations.session.method != "direct":
            # There the reading is the deviation itself, which explains itself.
            out["displacement"] = observations.readings.displacement
        out["path within the setup"] = _within(observations.path, observations.readings.setup)
    if np.abs(observations.table_direction).max() > 0 and observations.session.method == "probing":
        out["normal"] = np.arctan2(observations.table_direction[:, 1], observations.table_direction[:, 0])
    if observations.session.method in ("tracking_interferometer", "rotary_axis"):
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
