# SPDX-License-Identifier: Apache-2.0
"""Periodic error of a ball screw or scale."""

from functools import lru_cache

import numpy as np

from machine_tool_calibration.arrays import Array, groups
from machine_tool_calibration.effects.effect import AxisEffect, Coefficient, Shape, axis_unit
from machine_tool_calibration.machine.error_motions import interpolation
from machine_tool_calibration.model.observations import SAME_POSITION, Observations
from machine_tool_calibration.session.catalogue import spec_of
from machine_tool_calibration.words import say

_SHORTEST_LEAD = 2e-3  # m
_MOST_LEADS = 80  # that are tried whatever the readings say
# Share of the shortest wave, and of the range, within which positions are one place: no wave differs there.
_ONE_PLACE, _OF_RANGE = 0.05, 0.01
# Leads of ball screws, mm, and half of them: tried one by one where so many short waves fit into the range that they
# cannot all be.
_LEADS = (4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0, 30.0, 32.0, 40.0)
# Of the fewest waves of an axis that is read itself, over a network of places: there one may be looked for.
_OVER_PLACES = 2.0 / 3.0
# Step from wave to wave over one in the range; of others (racks, inches, motor steps) those that the readings show
# most, found by a spectrum so much finer, of places so many of which are a shortest wave, without what a table of so
# many nodes takes, and what is left clipped at so many median absolute deviations.
_STEP, _FINER, _PLACES, _NODES, _CLIPPED = 0.4, 4, 16, 6, 4.5
# Of either kind at most; waves that are looked at for them, or fewer where spectra have very many numbers together.
_PEAKS, _TRIED, _NUMBERS = 3, 16, 1 << 24
# Leads that are resolved, of which more than these tell a wave from one that is half a step beside it.
_MANY_LEADS = 20
# Share of a step by which positions may be off a grid, on which a wave of a shorter lead looks like one of a longer.
_ON_GRID = 0.05
# Readings of each direction where an axis moved the other way, too, from which it reversed.
_BOTH_WAYS = 3


class PitchPeriodic(AxisEffect):
    """Once a lead of the screw, or once a period of the scale; sine and cosine hold amplitude and phase."""

    id = "pitch_periodic_{axis}"
    title = say("effect.periodic")
    formula = "e_{axis} = s sin(2 pi {axis} / lead) + c cos(2 pi {axis} / lead)"
    kind = "position"
    source = "ISO 230-2:2014, periodic positioning error"
    coefficients = (
        Coefficient("s", "m", -5e-5, 5e-5, say("coefficient.wave_sine")),
        Coefficient("c", "m", -5e-5, 5e-5, say("coefficient.wave_cosine")),
    )
    # In a small step, which a range of hundreds of waves multiplies.
    shapes = (Shape("lead", "m", _SHORTEST_LEAD, 1.0, meaning=say("coefficient.wave_length"), step=1e-5),)
    needs: tuple[str, ...] = ("{axis}",)
    # Waves in the range of an axis that is read itself, at least: fewer are a curve, whose cause need not be a screw.
    fewest = 1.5

    def sign(self, observations: Observations) -> Array:
        """(n,) by which the wave is multiplied in each reading."""
        return np.ones(len(observations))

    def shape_grid(self, observations: Observations) -> list[tuple[float, ...]]:
        """Leads from the range covered down to what the positions can resolve.

        On evenly spaced positions every lead shorter than two steps looks like a longer one: only those are searched.
        """
        every, usual = self._frequencies(observations)
        if len(every) > _MANY_LEADS and spec_of(observations.session).reads_machine:
            usual = np.union1d(usual, self._strongest(observations, every, usual))
        return [(float(1.0 / f),) for f in usual]

    def equally(self, observations: Observations, shape: tuple[float, ...]) -> int:
        """Half the probability is that of the usual leads, the other half that of all, more of them between."""
        every, usual = self._frequencies(observations)
        if len(every) <= _MANY_LEADS:
            return 0
        off = float(np.abs(usual - 1.0 / shape[0]).min()) / (every[1] - every[0])
        finer = 1 if off < _ON_GRID else _FINER
        if len(usual) == len(every):
            return finer * len(every) if finer > 1 else 0
        return 2 * (finer * len(usual) if off < 0.5 else len(every))

    def _frequencies(self, observations: Observations) -> tuple[Array, Array]:
        """See `_resolved`."""
        direct = spec_of(observations.session).reads_machine
        fewest = self.fewest * (1.0 if direct else _OVER_PLACES)
        return _resolved(observations.readings.column(self.axis).tobytes(), fewest, direct)

    def _strongest(self, observations: Observations, every: Array, usual: Array) -> Array:
        """Those of which direct readings show most, all approaches in step, and what lies beside each.

        Half a step beside a usual one: that explains a tenth less, and in time waves are tried more finely.
        """
        from scipy.fft import next_fast_len  # here, as the catalogue is listed without it

        readings, along = observations.readings, self.along(observations)
        x, seen = readings.column(self.axis), readings.displacement * along * self.sign(observations)
        sense = readings.columns.get(f"dir_{self.axis}", np.zeros(len(x)))
        # On a circle every reading has a direction of its own: those of one sense along the axis are a group.
        group = groups(observations.run, sense, np.round(along))
        for mine in (group == g for g in range(int(group.max()) + 1)):
            places = len(np.unique(np.round(x[mine], 6)))
            nodes = np.linspace(x.min(), x.max(), max(min(_NODES, places // 4), 2))
            table = interpolation(nodes, x[mine]).T
            seen[mine] -= table @ np.linalg.lstsq(table, seen[mine], rcond=1e-9)[0]
        most = _CLIPPED * float(np.median(np.abs(seen)))
        seen = seen.clip(-most, most)
        width, step = 1.0 / (_PLACES * every[-1]), (every[1] - every[0]) / _FINER
        count = next_fast_len(round(1.0 / (step * width)), real=True)
        frequency, place = np.fft.rfftfreq(count, width), np.round((x - x.min()) / width).astype(np.int64)
        resolved = (frequency >= every[0]) & (frequency <= every[-1])
        # Beside a usual one, and away from all: where an axis bends the former are more than the latter.
        beside, away = list[float](), list[float]()
        for _ in range(min(_TRIED, max(_PEAKS, _NUMBERS // count))):
            power = np.abs(np.fft.rfft(np.bincount(place, seen), n=count))
            best = float(frequency[np.where(resolved, power, 0.0).argmax()])
            off = float(np.abs(usual - best).min()) / step
            if off > 0.5:
                (beside if off < 0.5 * _FINER else away).append(best)
            angle = 2.0 * np.pi * best * x
            wave = np.column_stack([np.sin(angle), np.cos(angle)]) * along[:, None] ** 2
            seen = seen - wave @ np.linalg.lstsq(wave, seen, rcond=None)[0]
        found = np.add.outer([*beside[:_PEAKS], *away[:_PEAKS]], step * np.array([-2.0, 0.0, 2.0])).ravel()
        return np.asarray(found[(found >= every[0]) & (found <= every[-1])])

    def columns(self, observations: Observations, shape: tuple[float, ...] = ()) -> Array:
        """Sine and cosine of the position, along the axis."""
        angle = 2.0 * np.pi * observations.readings.column(self.axis) / shape[0]
        along = self.along(observations) * self.sign(observations)
        return np.asarray([np.sin(angle) * along, np.cos(angle) * along])


def aliases(position: Array, lead: float) -> list[float]:
    """Shorter leads that look like one at these positions, m: the two nearest, where all are on one grid."""
    places = _places(position)
    step = float(np.median(np.diff(places))) if len(places) > 3 else np.inf
    off = (places - places[0]) / step
    if not np.isfinite(step) or np.abs(off - np.round(off)).max() > _ON_GRID or lead <= 2.0 * step:
        return []
    return [1.0 / (1.0 / step + sign / lead) for sign in (-1.0, 1.0)]


class SecondPeriodic(PitchPeriodic):
    """A second one: once half a lead, or of another part of the drive, such as a motor, a gear or the scale."""

    id = "second_periodic_{axis}"
    title = say("effect.second_periodic")
    beside = "pitch_periodic_{axis}"


class ReversalPeriodic(PitchPeriodic):
    """The same, of the other sign in the other direction: a motor's or a gear's torque against friction.

    What yields to the torque, which comes once a pole or a tooth, is behind or ahead by it. With fewer waves it is a
    lost motion that varies.
    """

    id = "reversal_periodic_{axis}"
    title = say("effect.reversal_periodic")
    formula = "e_{axis} = dir_{axis} (s sin(2 pi {axis} / lead) + c cos(2 pi {axis} / lead))"
    source = "ISO 230-2:2014, reversal value at every position; periodic torque of motors and gears"
    needs = ("{axis}", "dir_{axis}")
    seldom = True
    fewest = 5.0

    def why_not(self, observations: Observations) -> str | None:
        """Beside a wave of the map in each part of the travel."""
        why = super().why_not(observations)
        if why is None and _is_one_sided(observations, self.axis):
            return "no place was approached from both sides"
        return why

    def sign(self, observations: Observations) -> Array:
        """The direction of approach."""
        return observations.readings.column(f"dir_{self.axis}")


class StraightnessPeriodic(PitchPeriodic):
    """The same across the axis: a screw that is bent, or the balls of a guideway, moves the carriage aside.

    In a circular test it would otherwise be a vibration, which has a phase of its own in each run.
    """

    id = "straightness_periodic_{name}"
    title = say("effect.straightness_periodic")
    formula = "{name} = s sin(2 pi {axis} / lead) + c cos(2 pi {axis} / lead)"
    source = "ISO 230-1:2012, 3.4.3 (straightness error motion); run-out of a screw"
    methods = ("ball_bar",)
    seldom = True

    def along(self, observations: Observations) -> Array:
        """(n,) the part of the direction of the error, across the axis, that each reading senses."""
        return np.asarray(observations.direction @ axis_unit(self.name[1].lower()))


def _is_one_sided(observations: Observations, axis: str) -> bool:
    """Whether hardly a position of an axis lies where it moved the other way, too.

    Then what one direction changes is what one part of the travel has of its own, and no reversal.
    """
    position, sense = observations.readings.column(axis), observations.readings.column(f"dir_{axis}")
    up, down = position[sense > 0], position[sense < 0]
    if not len(up) or not len(down):
        return True
    low, high = max(up.min(), down.min()) - SAME_POSITION, min(up.max(), down.max()) + SAME_POSITION
    shared = min(int(np.sum((own >= low) & (own <= high))) for own in (up, down))
    return shared < min(_BOTH_WAYS, len(up), len(down))


@lru_cache(maxsize=32)  # asked for again with every frequency
def _resolved(read_at: bytes, fewest: float, direct: bool) -> tuple[Array, Array]:
    """All that positions resolve, and those that are tried whatever the readings say, waves per metre.

    From so many waves in the range; of positions along an axis that is read itself, or of a network of places.
    """
    position = _places(np.frombuffer(read_at))
    if len(position) < 4:
        return np.zeros(0), np.zeros(0)
    span, steps = float(np.ptp(position)), np.diff(position)
    even = float(np.ptp(steps)) < 1e-3 * float(steps.mean())
    shortest = 2.0 * float(steps.mean()) if even else max(_SHORTEST_LEAD, float(steps.mean()))
    every = np.arange(fewest / span, (1.0 - 1e-9) / shortest, _STEP / span)
    every = np.append(every, 1.0 / shortest) if len(every) else every
    if len(every) <= _MOST_LEADS:
        return every, every
    if not direct:
        return every, np.linspace(every[0], every[-1], _MOST_LEADS)
    # Long waves without a gap, and the usual leads beyond.
    known = np.unique([1e3 / (lead * share) for lead in _LEADS for share in (1.0, 0.5)])
    long = every[: _MOST_LEADS - len(known)]
    return every, np.concatenate([long, known[(known > long[-1] + 0.2 / span) & (known <= 1.0 / shortest)]])


def _places(position: Array) -> Array:
    """The first position of each place, in increasing order, m."""
    ordered = np.unique(np.round(position, 7))
    apart = min(_ONE_PLACE * _SHORTEST_LEAD, _OF_RANGE * float(np.ptp(ordered)))
    first, out = 0, []
    while first < len(ordered):
        out.append(ordered[first])
        # Positions are rounded; those that are evenly spaced stay so.
        first = max(first + 1, int(np.searchsorted(ordered, out[-1] + 0.999 * apart)))
    return np.array(out)
