# SPDX-License-Identifier: Apache-2.0
"""Structure in time: what comes suddenly, and waves."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from machine_tool_calibration.arrays import Array, IntArray, peaks
from machine_tool_calibration.diagnosis.search.candidates import Candidate, ShapedColumns
from machine_tool_calibration.diagnosis.search.evidence import NUMBERS_AT_ONCE
from machine_tool_calibration.effects.effect import axis_direction, table_axis
from machine_tool_calibration.model.observations import SAME_DIRECTION, Observations
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import Said, named, say

# Moments at which a step is tried: evenly among the readings, as effects may hide it at first, and where it explains
# most; moments that are looked at for that at first, and steps by which it is looked closer. Of what has several
# columns fewer.
_MOMENTS, _CHANGES, _LOOKED_AT, _CLOSER = 24, 6, 300, 8
# Frequencies of the periodogram for each independent one, and its largest peaks that are looked at.
_OVERSAMPLED, _PEAKS = 4, 8
_MOST_FREQUENCIES = 20000
# Intervals of readings from which a burst of them ends, and readings of a short one.
_BETWEEN_BURSTS, _IN_A_BURST = 3.0, 6
# Bands of waves, by periods over the whole session, one of which may be missing in each: slower ones are smooth
# functions; of those in these bands the model and what does not reproduce absorb much, of faster ones little.
_BANDS = ((2.5, 12.0), (12.0, 60.0))
# Sum of squares of a wave below which it is zero at all readings.
_NO_WAVE = 1e-12
# Targets of which each is tried by itself.
_MOST_TARGETS = 12

ENOUGH = 40
"""Fewer readings than this show neither a step nor a wave."""
Explained = Callable[[Callable[[float], Array], Array], list[Array]]
"""Sums of squares that columns by a value explain, for each of some values, in one or more ways."""


def events(observations: Observations, residual: Array, explained: Explained) -> Iterator[Candidate]:
    """What comes suddenly, and what comes and goes; the nonlinear coefficient is the moment or the period.

    The residuals (n,) are over the standard uncertainty.
    """
    name, time = _sequence(observations)
    covariate = named("column", name)
    for how, of in _sudden(observations, time):
        count = _MOMENTS // len(of(float(time[0])))
        evenly = np.quantile(time, (np.arange(count) + 1.0) / (count + 1.0))
        moments = np.union1d(evenly, _moments(time, of, explained)).tolist()
        steps = tuple(ShapedColumns((moment,), of(moment)) for moment in moments)
        yield Candidate.of_structure(covariate, how, steps, len(time))
    length, highest = float(np.ptp(time)), _samples(time) / 2.0
    # Where only the order is known, what is slower than a run over places is a function of the run and the place.
    run = observations.readings.repeat_of_setup
    least = 0 if observations.timed or not observations.moves else 1 + int(run.max())
    for lowest, end in _BANDS:
        frequency = _frequencies(max(lowest, least), min(end, highest)) / length
        if len(frequency):
            yield from _waves(covariate, time, frequency, explained(partial(_wave, time), frequency))
    frequency = _frequencies(_BANDS[-1][1], highest)[:_MOST_FREQUENCIES] / length
    if len(frequency):
        power = _periodogram(time - time[0], observations.run, residual, frequency)
        yield from _waves(covariate, time, frequency, [power])


def _sequence(observations: Observations) -> tuple[str, Array]:
    """Name and (n,) values of what the readings follow: time, s; where none was recorded their order, in readings.

    Of one pass along an axis, in which the order is the place, it is called by that, m.
    """
    if not observations.timed:
        for axis, position in zip("xyz", observations.position.T, strict=True):
            step = np.diff(position)
            if step.any() and (np.all(step >= 0) or np.all(step <= 0)):
                return axis, position
    return "time" if observations.timed else "order", observations.clock


def _sudden(observations: Observations, time: Array) -> Iterator[tuple[Said, Callable[[float], Array]]]:
    """What comes at a moment, by that: a step of the readings, and what was displaced."""
    yield say("shape.step_at", at=""), partial(_step, time)
    for how, along in _displaced(observations):
        yield how, partial(_step, time, along=along)


def _displaced(observations: Observations) -> Iterator[tuple[Said, Array]]:
    """(k, n) what a displacement along each axis changes: of instrument or part, of what is on the table, of a target.

    None where the beam of a setup has one direction: there it is a step.
    """
    direction, how = observations.direction, say("shape.shift_at", at="")
    along = _varying(direction)
    if spec_of(observations.session).reads_machine:
        if len(along) > 1:
            yield how, along
        return
    setup = observations.readings.setup
    if not any(len(_varying(direction[setup == k])) for k in np.unique(setup)):
        return
    yield how, along
    angle = observations.readings.columns.get(table_axis(observations).lower())
    if angle is None or np.ptp(angle) == 0.0:
        return
    turns = np.outer(observations.session.rotation_sign * angle, axis_direction(table_axis(observations)))
    along = _varying(Rotation.from_rotvec(turns).inv().apply(direction))
    if not len(along):  # one face alone
        return
    yield say("shape.shift_on_table_at", at=""), along
    target = observations.readings.labels.get("target", np.zeros(0, dtype=str))
    names = np.unique(target)
    for name in names if 2 <= len(names) <= _MOST_TARGETS else ():
        yield say("shape.shift_of_target_at", at="", target=str(name)), (target == name) * along


def _varying(direction: Array) -> Array:
    """(k, n) those components of directions (n, 3) that vary."""
    return np.asarray(direction[:, np.ptp(direction, axis=0) > SAME_DIRECTION].T)


def _moments(time: Array, of: Callable[[float], Array], explained: Explained) -> Array:
    """Moments from which something explains most, each the time of the last reading before: closer and closer."""
    every = np.unique(time)[:-1]
    stride = -(-len(every) * len(of(float(time[0]))) // _LOOKED_AT)
    some = np.arange(0, len(every), stride)
    while True:
        powers = explained(of, every[some])
        best = np.unique(np.concatenate([some[peaks(power)[:_CHANGES]] for power in powers]))
        if stride == 1:
            return np.asarray(every[best])
        stride = -(-stride // _CLOSER)
        near = best[:, None] + stride * np.arange(-_CLOSER, _CLOSER + 1)
        some = np.unique(np.clip(near, 0, len(every) - 1))


def _waves(covariate: str, time: Array, frequency: Array, powers: list[Array]) -> Iterator[Candidate]:
    """Those of a band, at the peaks of sums of squares."""
    near = {one for power in powers for one in _around(frequency, peaks(power)[:_PEAKS])}
    waves = tuple(ShapedColumns((1.0 / one,), _wave(time, one)) for one in sorted(near))
    if waves:
        # As many of them are independent as there are periods over the session.
        independent = round(float(np.ptp(time) * np.ptp(frequency)))
        candidate = Candidate.of_structure(covariate, say("shape.wave", at=""), waves, independent)
        yield replace(candidate, name=f"{candidate.name}{frequency[0]:.3g} Hz")


def _rotating(frequency: Array | float, time: Array) -> npt.NDArray[np.complex128]:
    """([f,] n) cosine and, as its imaginary part, sine of frequencies over time."""
    phase = 2.0 * np.pi * np.multiply.outer(frequency, time)
    wave = np.empty(phase.shape, dtype=complex)
    # Faster than the exponential function of a complex number.
    np.cos(phase, out=wave.real)
    np.sin(phase, out=wave.imag)
    return wave


def _step(time: Array, moment: float, along: Array | float = 1.0) -> Array:
    return np.asarray((time > moment)[None] * along, dtype=np.float64)


def _wave(time: Array, frequency: float) -> Array:
    phase = 2.0 * np.pi * frequency * (time - time[0])
    return np.array([np.sin(phase), np.cos(phase)])


def _samples(time: Array) -> int:
    """Number of readings; where they come in short bursts that of bursts: faster waves are aliases of slow ones."""
    gap = np.diff(np.sort(time))
    bursts = 1 + int(np.sum(gap > _BETWEEN_BURSTS * np.median(gap)))
    return bursts if len(time) <= _IN_A_BURST * bursts else len(time)


def _frequencies(lowest: float, highest: float) -> Array:
    """Frequencies in periods over the session, several for each independent one."""
    return np.arange(lowest, highest, 1.0 / _OVERSAMPLED)


def _around(frequency: Array, places: IntArray) -> list[float]:
    """Frequencies at some places, and half a step beside them."""
    half = 0.5 * float(frequency[1] - frequency[0]) if len(frequency) > 1 else 0.0
    return [float(frequency[k] + shift) for k in places for shift in (-half, 0.0, half)]


def _periodogram(time: Array, run: IntArray, values: Array, frequency: Array) -> Array:
    """(f,) sum of squares that a sine and a cosine of each frequency explain beside the means of runs.

    Lomb (1976) and Scargle (1982), with a mean of each run; of fast waves the model absorbs little else.
    """
    order = np.argsort(run, kind="stable")
    time, values, run = time[order], values[order], run[order]
    first, size = np.unique(run, return_index=True, return_counts=True)[1:]
    values = values - np.repeat(np.add.reduceat(values, first) / size, size)
    out = np.empty(len(frequency))
    # Frequencies are equally far apart: multiplied by the same factors, the first wave of a batch gives the others.
    step = min(max(int(NUMBERS_AT_ONCE / len(time)), 1), len(frequency))
    factors = _rotating(frequency[:step] - frequency[0], time)
    begin, onward = _rotating(frequency[0], time), _rotating(step * np.diff(frequency[:2]).sum(), time)
    for part in (slice(k, k + step) for k in range(0, len(frequency), step)):
        wave = begin * factors[: len(frequency[part])]
        begin = begin * onward
        means = np.add.reduceat(wave, first, axis=1) / size
        # With z the wave, the sums of z conj(z) and of z z have the products of sine and cosine.
        both = len(time) - np.abs(means) ** 2 @ size
        twice = np.einsum("fn,fn->f", wave, wave) - means**2 @ size
        along = wave @ values
        determinant = both**2 - np.abs(twice) ** 2
        explained = 2.0 * (both * np.abs(along) ** 2 - np.real(np.conj(twice) * along**2))
        seen = determinant > _NO_WAVE * len(time) ** 2
        out[part] = np.where(seen, explained / np.where(seen, determinant, 1.0), 0.0)
    return out
