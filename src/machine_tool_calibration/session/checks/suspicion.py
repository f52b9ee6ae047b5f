# SPDX-License-Identifier: Apache-2.0
"""Readings that can be used and that a measurement hardly gives: said beside the result, not refused."""

from collections.abc import Iterator, Sequence

import numpy as np

from machine_tool_calibration.arrays import Array, groups, occurrence
from machine_tool_calibration.session import DESCRIPTION_FILE
from machine_tool_calibration.session.approach import approaches
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.session.gaps import filled, spikes
from machine_tool_calibration.session.session import ENOUGH_TO_DIFFER, ENVIRONMENT_COLUMNS, Session
from machine_tool_calibration.words import say, together

_FEWEST_COPIES = 4  # equal readings: fewer may be alike by chance
_FEWEST_MOVES = 8  # moves beside directions of approach: fewer may be against them by chance
_HARDLY_DIFFER = 0.1  # share of a reading's standard uncertainty that readings differ by: of eight by chance below 1e-7
_BEYOND_TRAVEL = 0.1  # share of the travel by which a probed part may reach beyond it
_COARSE = 3.46  # a step of so many standard uncertainties is as uncertain by itself
_WRITTEN = 1e-8  # m or rad: positions are written with so many decimals that they differ by less
_WHOLE = 1e-6  # of a step: rounding
_BY_CHANCE = 0.01  # probability of equal readings below which they are one reading
_CHANGES = 0.2  # K by which a temperature changes while another one should, too
_OPPOSITE = 0.9  # share of the moves against which an approach was, where signs are exchanged
_FEW_OPPOSITE = 0.05  # the same, of moves within runs, where they are in single rows


def suspicions(sessions: Sequence[Session], labels: Sequence[str] | None = None) -> list[str]:
    """What is suspicious in sessions, in words.

    Readings that are all the same, or differ by less than their own uncertainty makes them differ: not read, or in
    another unit. Rows written twice. Places off the machine's travel. Fewer or more repeats than stated. Directions of
    approach against the moves. Spikes and gaps of sensors. And what the method finds (`MethodSpec.suspicious`).
    """
    named = [""] * len(sessions) if labels is None else [f"{label}: " for label in labels]
    pairs = zip(named, sessions, strict=True)
    sensors = (_spiked, _stands, _missed)
    checks = (_still, _rounded, _copied, read_off, _beside, _recorded, _repeated, _approached, _unrecorded, *sensors)
    return [
        together((name, words), "")
        for name, session in pairs
        for check in (*checks, spec_of(session).suspicious)
        for words in check(session)
    ]


def _still(session: Session) -> Iterator[str]:
    readings = session.readings.displacement[np.isfinite(session.readings.displacement)]
    if len(readings) < ENOUGH_TO_DIFFER:
        return
    spread, sigma = float(np.ptp(readings)), session.sigma
    if not readings.any():
        yield say("suspicion.all_zero", n=len(readings))
    elif spread == 0.0:
        yield say("suspicion.all_same", n=len(readings), value=f"{readings[0]:g}")
    elif spread < _HARDLY_DIFFER * sigma:
        yield say("suspicion.hardly_differ", n=len(readings), spread=f"{spread:.2g}", sigma=f"{sigma:.2g}")


def _rounded(session: Session) -> Iterator[str]:
    """Readings that are whole multiples of more than their uncertainty: written with too few decimals."""
    readings = session.readings.displacement[np.isfinite(session.readings.displacement)]
    for step in (10.0**k for k in range(-3, -9, -1)):
        whole = np.abs(readings / step - np.round(readings / step)) < _WHOLE
        if step > _COARSE * session.sigma and len(readings) >= ENOUGH_TO_DIFFER and np.ptp(readings) and whole.all():
            yield say("suspicion.rounded", step=f"{step:g}", sigma=f"{session.sigma:.2g}")
            return


def _copied(session: Session) -> Iterator[str]:
    """Rows of one setup, repeat, place and direction with the same reading: each of several, or more than by chance."""
    readings = session.readings.select(np.isfinite(session.readings.displacement))
    again, equal = (occurrence(group) > 0 for group in (readings.state, groups(readings.state, readings.displacement)))
    every = equal.sum() >= _FEWEST_COPIES and (equal == again).all() and np.ptp(readings.displacement) > 0.0
    equal &= every | (readings.displacement != 0.0)
    if every or (equal.any() and _hardly_by_chance(readings.displacement[~equal], int(again.sum()), session.sigma)):
        yield say("suspicion.copied", n=int(equal.sum()), row=int(readings.row[equal][0]))


def read_off(session: Session) -> Iterator[str]:
    """Positions that scatter about places: read off an encoder."""
    for axis, off in session.readings.off_place.items():
        if (most := float(np.abs(off).max(initial=0.0))) < _WRITTEN:
            continue
        places = len(np.unique(session.readings.columns[axis]))
        unit = "µrad" if axis in "abc" else "µm"
        yield say("suspicion.read_off", axis=axis, n=places, most=f"{1e6 * most:.2g}", unit=unit)


def _hardly_by_chance(others: Array, count: int, sigma: float) -> bool:
    """Whether none of so many second readings equals the first: their steps, which others show, are far below noise."""
    fine = (10.0**-k for k in range(3, 13) if (np.abs(others * 10.0**k - np.round(others * 10.0**k)) < _WHOLE).all())
    told = others[others != 0.0]
    return count * next(fine, 0.0) < _BY_CHANCE * _COARSE * sigma and len(np.unique(told)) == len(told)


def _beside(session: Session) -> Iterator[str]:
    for name, (low, high) in session.description.machine.travel.items():
        if (values := session.readings.columns.get(name.lower())) is None:
            continue
        over = _BEYOND_TRAVEL * (high - low)
        off = np.flatnonzero((values < low - over) | (values > high + over))
        if len(off):
            unit = "m" if name.lower() in "xyz" else "rad"
            worst = values[off[np.argmax(np.maximum(low - values[off], values[off] - high))]]
            ends = {"low": f"{low:g}", "high": f"{high:g}", "worst": f"{worst:g}", "unit": unit}
            names = {"axis": name.upper(), "column": name.lower()}
            yield say("suspicion.off_travel", n=len(off), count=len(values), **names, **ends)


def _recorded(session: Session) -> Iterator[str]:
    """Readings that a recording lacks, and its runs and messages that are not looked at."""
    if lost := session.as_recorded.lost:
        yield say("suspicion.lost", n=lost)
    if earlier := session.as_recorded.earlier:
        yield say("suspicion.earlier", n=len(earlier), readings=", ".join(map(str, earlier)))
    if none := session.as_recorded.no_readings:
        yield say("suspicion.no_readings", n=len(none), first=none[0])


def _repeated(session: Session) -> Iterator[str]:
    repeats = np.unique(session.as_recorded.readings.repeat)
    if len(repeats) != session.description.repeats:
        named = f"{', '.join(map(str, repeats[:8]))}{' …' if len(repeats) > 8 else ''}"
        stated = session.description.repeats
        yield say("suspicion.repeats", stated=stated, file=DESCRIPTION_FILE, n=len(repeats), repeats=named)


def _approached(session: Session) -> Iterator[str]:
    """Directions of approach against the moves; a probe goes back before it approaches."""
    readings, columns = session.readings, session.readings.columns
    # Whence the first reading of a run comes the row before does not say.
    within = np.diff(groups(readings.setup, readings.repeat)) == 0
    for name in [] if "point" in readings.labels else [n for n in columns if f"dir_{n}" in columns]:
        move, sense = np.sign(np.round(np.diff(columns[name]), 9)), columns[f"dir_{name}"][1:]
        against, n = move * sense == -1.0, int(np.count_nonzero(move * sense))
        # From one side alone many machines approach whichever way they come.
        if n < _FEWEST_MOVES or len(np.unique(sense[move != 0.0])) < 2:
            continue
        if against.sum() > _OPPOSITE * n:
            yield say("suspicion.approach", column=name, n=int(against.sum()), count=n)
        # On a circle an axis turns between two readings.
        single = np.flatnonzero(against & within & (not spec_of(session).centred))
        if 0 < len(single) <= _FEW_OPPOSITE * n:
            row = int(readings.row[single[0] + 1])
            yield say("suspicion.few_approach", column=name, n=len(single), count=n, row=row)


def _unrecorded(session: Session) -> Iterator[str]:
    for name in approaches(session):
        yield say("suspicion.unrecorded_approach", column=name)


def _spiked(session: Session) -> Iterator[str]:
    columns, known = session.readings.columns, filled(session.readings.columns)
    for name in (name for name in ENVIRONMENT_COLUMNS if name in columns):
        found = spikes(columns, name)
        if len(found):
            row, value = int(session.readings.row[found[0]]), f"{columns[name][found[0]]:.5g}"
            key = "suspicion.spike" if name in known else "suspicion.spike_used"
            yield say(key, column=name, n=len(found), row=row, value=value)


def _stands(session: Session) -> Iterator[str]:
    """A sensor that says the same all the time while another one changes."""
    columns = session.readings.columns
    ranges = {n: float(np.ptp(v)) for n, v in columns.items() if n.startswith("temperature_") and np.isfinite(v).all()}
    for name in [name for name, own in ranges.items() if own == 0.0 and max(ranges.values()) > _CHANGES]:
        yield say("suspicion.stands", column=name, value=f"{columns[name][0]:.5g}", n=len(session.readings))


def _missed(session: Session) -> Iterator[str]:
    """Values of a sensor that are missing."""
    columns, read = session.readings.columns, np.isfinite(session.readings.displacement)
    known, count = filled(columns), int(read.sum())
    for name in (*ENVIRONMENT_COLUMNS, *(f"dir_{axis}" for axis in "xyzabc")):
        gone = int(np.sum(read & ~np.isfinite(columns[name]))) if name in columns else 0  # spikes are told already
        if 0 < gone < count:
            how = f"{'filled' if name in known else 'missed'}{'_approach' if name.startswith('dir_') else ''}"
            yield say(f"suspicion.{how}", column=name, n=gone, count=count)
